#include "services/viewer/state_json.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/support/placement.h"

namespace splinemap::state_json_test {

using nlohmann::json;

// A bus with a robot whose poses begin at (10, 0) of its layer, and look along y.
class PlacedPosesTest : public testing::Test {
 protected:
  PlacedPosesTest() {
    AddDaemon("robot", 7, 100);
    bus_.frames[{"robot", 7}] = {{{10, 0}, M_PI / 2}, Clock::now()};
    bus_.poses["POSE"] = {{{1, 2}, 0}, Clock::now()};
    bus_.scans["LASER"] = {{{1, 2}, {{3, 2}}}, Clock::now()};
  }

  void AddDaemon(const std::string& name, int64_t origin, int64_t poses) {
    status_t status{};
    status.name = name;
    status.origin = origin;
    status.poses_received = poses;
    bus_.daemons[static_cast<int64_t>(bus_.daemons.size())] = {status, Clock::now()};
  }
  Pose2 Frame() const { return MapFromPoses(bus_, settings_); }

  BusState bus_;
  SettingsTable settings_;
};

TEST(DaemonsJsonTest, ADaemonThatHadNoTimeToAnswerIsNotSilent) {
  BusState bus;
  bus.daemons[1] = {status_t{}, Clock::now() - std::chrono::seconds(60)};
  EXPECT_LT(json::parse(DaemonsJson(bus, Clock::now()))[0]["heard_s_ago"], 1);
  const auto before = Clock::now() - std::chrono::seconds(10);
  EXPECT_GE(json::parse(DaemonsJson(bus, before))[0]["heard_s_ago"], 10);
}

TEST_F(PlacedPosesTest, TheRobotIsWhereItsDaemonSays) {
  const json pose = json::parse(PosesJson(bus_, Frame()))[0];
  EXPECT_EQ(pose["x_m"], 8);
  EXPECT_EQ(pose["y_m"], 1);
  EXPECT_NEAR(pose["yaw_rad"].get<double>(), M_PI / 2, 1e-9);
  const json scan = json::parse(ScansJson(bus_, Frame()))[0];
  EXPECT_EQ(scan["sensor"]["x_m"], 8);
  EXPECT_EQ(scan["points_m"], json({8, 3}));
}

TEST_F(PlacedPosesTest, TheLayerMayBePlacedOnTopOfThat) {
  settings_.Merge({"robot", 7}, {.placement = ShiftBy(3, -2), .counter = 1});
  const Eigen::Vector2d shift = settings_.Of({"robot", 7}).placement.ToPose().position_m;
  EXPECT_GT(shift.norm(), 0);
  EXPECT_LT((Frame().position_m - (Eigen::Vector2d(10, 0) + shift)).norm(), 1e-6);
}

TEST_F(PlacedPosesTest, OneThatHearsNoPosesIsNoRobot) {
  AddDaemon("base station", 8, 0);
  EXPECT_EQ(Frame().position_m, Eigen::Vector2d(10, 0));
}

TEST_F(PlacedPosesTest, OfSeveralRobotsNobodyKnowsWhosePosesTheyAre) {
  AddDaemon("other", 8, 100);
  EXPECT_EQ(Frame().position_m, Eigen::Vector2d(0, 0));
}

TEST_F(PlacedPosesTest, ARobotWithAnotherMapIsTheSame) {
  AddDaemon("robot", 9, 100);
  bus_.frames[{"robot", 9}] = {{{5, 0}, 0}, Clock::now()};
  EXPECT_EQ(Frame().position_m, Eigen::Vector2d(5, 0));
}

TEST(TimesJsonTest, NowIsNull) {
  const json times = json::parse(TimesJson({Utime(5), Utime(9), {}, Utime(7), "no"}));
  EXPECT_EQ(times, json::parse(R"({"first_utime": 5, "last_utime": 9, "shown_utime": null,
                                   "wanted_utime": 7, "problem": "no"})"));
}

}  // namespace splinemap::state_json_test
