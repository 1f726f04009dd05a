#include "lib/wire/trajectory_parts.h"

#include <gtest/gtest.h>

#include <vector>

#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/wire/encode.h"

namespace splinemap::trajectory_parts_test {

// Of one pose, at `pose_utime`.
std::vector<uint8_t> Part(int64_t utime, int part, int parts, int64_t pose_utime,
                          const std::string& robot = "robot") {
  trajectory_t message{};
  message.utime = utime;
  message.robot = robot;
  message.part = part;
  message.num_parts = parts;
  message.num_poses = 1;
  message.pose_utime = {pose_utime};
  message.x_m = message.y_m = message.yaw_rad = {1};
  return Encode(message);
}

std::vector<int64_t> TimesOf(const absl::StatusOr<std::optional<Trajectory>>& trajectory) {
  std::vector<int64_t> times;
  if (!trajectory.ok() || !*trajectory) return times;
  for (const TrajectoryPose& pose : (*trajectory)->poses) times.push_back(pose.utime.count());
  return times;
}

using Times = std::vector<int64_t>;

TEST(TrajectoryPartsTest, ComeInAnyOrderAndMoreThanOnce) {
  TrajectoryParts parts("robot");
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 2, 3, 30))), Times());
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 0, 3, 10))), Times());
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 0, 3, 10))), Times());
  const auto whole = parts.Add(Part(9, 1, 3, 20));
  EXPECT_EQ(TimesOf(whole), (Times{10, 20, 30}));
  EXPECT_EQ((*whole)->until, Utime(9));
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 0, 1, 40))), Times{40}) << "the next one";
}

TEST(TrajectoryPartsTest, AnotherTrajectoryDropsOneThatIsNotWhole) {
  TrajectoryParts parts("robot");
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 0, 2, 10))), Times());
  EXPECT_EQ(TimesOf(parts.Add(Part(12, 1, 2, 40))), Times());
  EXPECT_EQ(TimesOf(parts.Add(Part(12, 0, 2, 30))), (Times{30, 40}));
}

TEST(TrajectoryPartsTest, OfOtherRobotsAreIgnoredAndOfNobodyAreForAll) {
  TrajectoryParts parts("robot");
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 0, 1, 10, "other"))), Times());
  EXPECT_EQ(TimesOf(parts.Add(Part(9, 0, 1, 10, ""))), Times{10});
}

TEST(TrajectoryPartsTest, ThatCannotBeAreRefused) {
  TrajectoryParts parts("robot");
  for (const auto& [part, num_parts] :
       {std::pair(0, 0), {1, 1}, {-1, 2}, {0, TrajectoryParts::kMaxParts + 1}, {0, -1}}) {
    EXPECT_TRUE(absl::IsInvalidArgument(parts.Add(Part(9, part, num_parts, 1)).status()));
  }
  EXPECT_FALSE(parts.Add(Part(9, 0, 1, -5)).ok()) << "a stamp of before 1970";
  std::vector<uint8_t> cut = Part(9, 0, 1, 1);
  cut.pop_back();
  EXPECT_FALSE(parts.Add(cut).ok());
}

}  // namespace splinemap::trajectory_parts_test
