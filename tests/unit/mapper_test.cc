#include "lib/pipeline/mapper.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lib/wire/encode.h"
#include "splinemap/map_view.h"
#include "tests/support/map_writer.h"

namespace splinemap::mapper_test {

class MapperTest : public testing::Test {
 protected:
  void Configure(const std::string& scan_flag) {
    config_.set_pose("POSE");
    config_.clear_scan();
    *config_.add_scan() = *ParseScanFlag(scan_flag);
    ASSERT_TRUE(CheckConfig(config_).ok());
    mapper_.emplace(config_, map_.options(), layer_);
  }

  void Pose(int64_t ms, double x_m = 0, double yaw_rad = 0) {
    mapper_->HandleMessage(
        "POSE", Encode(PoseMessage({std::chrono::milliseconds(ms), {{x_m, 0}, yaw_rad}})));
  }

  // One beam to the left, 2 m.
  void ScanLeft(int64_t ms) {
    mapper_->HandleMessage(
        "LASER", Encode(PlanarLidarMessage(std::chrono::milliseconds(ms), {2}, M_PI / 2, 0)));
  }

  int64_t Problems(Problem problem) const {
    return mapper_->counts().problems[static_cast<int>(problem)];
  }

  double At(double x_m, double y_m) { return map_.View()->Evaluate(x_m, y_m).log_odds; }
  // The most within 0.06 m: an obstacle begins where it is hit.
  double Near(double x_m, double y_m) {
    double most = At(x_m, y_m);
    for (int k = 0; k < 13 * 13; ++k) {
      most = std::max(most, At(x_m - 0.06 + 0.01 * (k % 13), y_m - 0.06 + 0.01 * (k / 13)));
    }
    return most;
  }

  config::Config config_;
  MapWriter map_{{}};
  Layer& layer_ = map_.AddLayer({"robot", 1}, {1, 1});
  std::optional<Mapper> mapper_;
};

TEST_F(MapperTest, ABeamEndsWhereTheSensorSaysIt) {
  Configure("LASER:bot_core,x_m=0.5");
  Pose(0, 1);
  ScanLeft(0);
  EXPECT_GT(Near(1.5, 2), 0.5);
  EXPECT_LT(At(1.5, 1), -0.2);
  EXPECT_EQ(mapper_->counts().scans_mapped, 1);
  EXPECT_EQ(mapper_->counts().beams_mapped, 1);
  EXPECT_EQ(mapper_->newest_scan_utime(), Utime(0));
}

TEST_F(MapperTest, TheSignOfBearingMirrorsTheScan) {
  Configure("LASER:bot_core,bearing_sign=-1");
  Pose(0);
  ScanLeft(0);
  EXPECT_GT(Near(0, -2), 0.5);
}

TEST_F(MapperTest, TimeOffsetMovesTheScanAlongThePath) {
  Configure("LASER:bot_core,time_offset_ms=-200");
  Pose(0, 0);
  Pose(1000, 1);
  ScanLeft(700);
  EXPECT_GT(Near(0.5, 2), 0.5);
}

TEST_F(MapperTest, MichiganScansAreToldByTheirBeamTimes) {
  Configure("LASER");
  Pose(0, 0);
  Pose(1000, 1);
  michigan::lidar_t lidar;
  lidar.utime = 100'000;
  lidar.num_ranges = 2;
  lidar.ranges = {2, 2};
  lidar.thetas = {static_cast<float>(M_PI / 2), static_cast<float>(M_PI / 2)};
  lidar.times = {100'000, 600'000};  // preset michigan_2014: clockwise, times of the beams
  lidar.intensities = {0, 0};
  mapper_->HandleMessage("LASER", Encode(lidar));
  EXPECT_GT(Near(0.1, -2), 0.5);
  EXPECT_GT(Near(0.6, -2), 0.5);
  ASSERT_EQ(mapper_->DrainNotices().size(), 1u);
  EXPECT_TRUE(mapper_->DrainNotices().empty());
}

TEST_F(MapperTest, WhatCannotBeUsedIsCountedAndSaid) {
  Configure("LASER:bot_core");
  const std::vector<uint8_t> garbage = {1, 2, 3};
  for (int n = 0; n < 3; ++n) {
    mapper_->HandleMessage("LASER", garbage);
    mapper_->HandleMessage("POSE", garbage);
    Pose(0, 1e9);
    mapper_->HandleMessage("OTHER", garbage);
  }
  Pose(0);
  Pose(0);
  const MapperCounts counts = mapper_->counts();
  EXPECT_EQ(counts.drops[DropReason::kWrongTypeOfScan], 3);
  EXPECT_EQ(counts.drops[DropReason::kWrongTypeOfPose], 3);
  EXPECT_EQ(counts.drops[DropReason::kPoseOutOfRange], 3);
  EXPECT_EQ(counts.drops[DropReason::kDuplicatePose], 1);
  EXPECT_EQ(counts.drops.Total(), 10);
  EXPECT_EQ(counts.messages_received, 11);
  EXPECT_EQ(counts.scans_received, 3);
  EXPECT_EQ(counts.poses_received, 8);
  EXPECT_EQ(mapper_->DrainNotices().size(), 4u);
  EXPECT_EQ(layer_.revision(), 0u);
}

TEST_F(MapperTest, AChannelOfAnotherTypeIsDescribed) {
  Configure("LASER:bot_core");
  mapper_->HandleMessage("LASER", Encode(PoseMessage({Utime(0), {}})));
  const std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_NE(notices[0].text.find("0x2e16efb052b0105e, which is bot_core.pose_t"), std::string::npos)
      << notices[0].text;
}

TEST_F(MapperTest, TheMotionFilterSkipsARobotThatStandsStill) {
  Configure("LASER:bot_core,min_travel_m=0.5,min_turn_deg=20");
  const auto drive = [&](int64_t ms, double x_m, double yaw_rad) {
    Pose(ms, x_m, yaw_rad);
    ScanLeft(ms);
  };
  drive(0, 0, 0);
  drive(100, 0.4, 0);
  drive(200, 0.4, 0.3);
  EXPECT_EQ(mapper_->counts().scans_mapped, 1);
  drive(300, 0.4, 0.4);
  drive(400, 1.0, 0.4);
  EXPECT_EQ(mapper_->counts().scans_mapped, 3);
  EXPECT_EQ(mapper_->counts().drops[DropReason::kStoodStill], 2);
  EXPECT_TRUE(mapper_->DrainNotices().empty()) << "as configured";
}

TEST_F(MapperTest, ExtrinsicsComeFromTheirChannel) {
  Configure("LASER:bot_core,extrinsics_channel=MOUNT");
  EXPECT_EQ(mapper_->channels(), (std::vector<std::string>{"LASER", "MOUNT", "POSE"}));
  const auto mount = [&](double x_m, double about_x_rad) {
    bot_core::rigid_transform_t transform{};
    transform.trans[0] = x_m;
    transform.quat[0] = std::cos(about_x_rad / 2);
    transform.quat[1] = std::sin(about_x_rad / 2);
    mapper_->HandleMessage("MOUNT", Encode(transform));
  };
  Pose(0);
  ScanLeft(0);
  EXPECT_EQ(mapper_->counts().drops[DropReason::kNoExtrinsics], 1);
  mount(0.5, 0);
  Pose(100);
  ScanLeft(100);
  EXPECT_GT(Near(0.5, 2), 0.5);
  mount(5, M_PI / 2);
  EXPECT_EQ(mapper_->counts().drops[DropReason::kMalformedExtrinsics], 1) << "tilted";
  mount(-1, M_PI);
  Pose(200);
  ScanLeft(200);
  EXPECT_GT(Near(-1, -2), 0.5) << "upside down";
  mapper_->HandleMessage("MOUNT", Encode(PoseMessage({Utime(0), {}})));
  EXPECT_EQ(mapper_->counts().drops[DropReason::kMalformedExtrinsics], 2) << "another type";
}

TEST_F(MapperTest, BeamTimesThatAreAllTheSameAreSaid) {
  Configure("LASER:michigan_2014");
  michigan::lidar_t lidar;
  lidar.utime = 100'000;
  lidar.num_ranges = 2;
  lidar.ranges = {2, 2};
  lidar.thetas = {0, 1};
  lidar.times = {100'000, 100'000};
  lidar.intensities = {0, 0};
  mapper_->HandleMessage("LASER", Encode(lidar));
  EXPECT_EQ(Problems(Problem::kUselessBeamTimes), 1);
  const std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_NE(notices[0].text.find("michigan_2017"), std::string::npos) << notices[0].text;
  lidar.utime = 200'000;
  lidar.times = {200'000, 300'000};
  mapper_->HandleMessage("LASER", Encode(lidar));
  EXPECT_EQ(Problems(Problem::kUselessBeamTimes), 1);
}

TEST_F(MapperTest, AnotherClockIsSaidWithTheOffsetThatMends) {
  Configure("LASER:bot_core,time_offset_ms=100");
  for (int n = 0; n < 60; ++n) {
    Pose(100 * n);
    ScanLeft(100 * n + 50'000);
  }
  EXPECT_EQ(Problems(Problem::kWithoutPoses), 2) << "every 20 scans";
  const std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_NE(notices[0].text.find("50.1 s after the poses of POSE"), std::string::npos)
      << notices[0].text;
  EXPECT_NE(notices[0].text.find("time_offset_ms=-50000"), std::string::npos) << notices[0].text;
}

TEST_F(MapperTest, AChannelInAnotherClockIsToldBesideOneThatIsFine) {
  Configure("LASER:bot_core");
  *config_.add_scan() = *ParseScanFlag("REAR:bot_core");
  mapper_.emplace(config_, map_.options(), layer_);
  for (int n = 0; n < 60; ++n) {
    Pose(1'000'000 + 100 * n);
    ScanLeft(1'000'000 + 100 * n);
    mapper_->HandleMessage(
        "REAR", Encode(PlanarLidarMessage(std::chrono::milliseconds(100 * n), {2}, 0, 0)));
  }
  EXPECT_GE(mapper_->counts().scans_mapped, 55);
  ASSERT_EQ(Problems(Problem::kWithoutPoses), 3) << "every 20 scans";
  const std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_EQ(notices[0].text.substr(0, 4), "REAR");
  EXPECT_NE(notices[0].text.find("time_offset_ms=1000"), std::string::npos) << notices[0].text;
}

TEST_F(MapperTest, ALocalisationThatJumpsIsSaid) {
  Configure("LASER:bot_core");
  // Walls all around, 2 m away; a robot that is taken to be 0.7 m further looks through them.
  const auto scan = [&](int64_t ms, double x_m) {
    Pose(ms, x_m);
    mapper_->HandleMessage("LASER",
                           Encode(PlanarLidarMessage(std::chrono::milliseconds(ms),
                                                     std::vector<float>(180, 2), 0, M_PI / 90)));
  };
  for (int n = 0; n < 300; ++n) scan(100 * n, 0);
  EXPECT_EQ(Problems(Problem::kMapDisagrees), 0);
  for (int n = 300; n < 325; ++n) scan(100 * n, 0.7);
  EXPECT_GE(Problems(Problem::kMapDisagrees), 1);
}

TEST_F(MapperTest, PosesAtTheEdgeOfTheRangeAreMappedSafely) {
  Configure("LASER:bot_core");
  const double edge_m = 0.9 * kMaxKnotIndex * 0.05 - 1;
  Pose(0, edge_m);
  ScanLeft(0);
  EXPECT_GT(Near(edge_m, 2), 0.5);
}

TEST_F(MapperTest, ALocalisationThatFallsSilentIsSaidEachTime) {
  Configure("LASER:bot_core");
  ScanLeft(0);
  Pose(10);
  int64_t ms = 100;
  for (int time = 1; time <= 2; ++time) {
    Pose(ms);
    ScanLeft(ms);
    mapper_->DrainNotices();
    for (int n = 0; n < 60; ++n) ScanLeft(ms += 100);
    const std::vector<Notice> notices = mapper_->DrainNotices();
    ASSERT_EQ(notices.size(), 1u);
    EXPECT_TRUE(notices[0].is_problem);
    EXPECT_NE(notices[0].text.find("Has POSE stopped"), std::string::npos) << notices[0].text;
    ms += 100;
  }
  EXPECT_EQ(mapper_->counts().scans_mapped, 2);
}

TEST_F(MapperTest, AForeignScanDoesNotChooseThePresetOfTheOthers) {
  Configure("LASER");
  michigan::lidar_t lidar;
  lidar.utime = 100'000;
  lidar.num_ranges = 2;
  lidar.ranges = {2, 2};
  lidar.thetas = {0, 0};
  lidar.times = {100'000, 100'000};
  lidar.intensities = {0, 0};
  mapper_->HandleMessage("LASER", Encode(lidar));
  Pose(0);
  Pose(1000);
  ScanLeft(500);
  EXPECT_GT(Near(0, 2), 0.5) << "bot_core, and not michigan_2017";
}

TEST_F(MapperTest, APresetIsToldFromTheFirstScanWithBeams) {
  Configure("LASER");
  michigan::lidar_t lidar;
  lidar.utime = 100'000;
  lidar.num_ranges = 0;
  mapper_->HandleMessage("LASER", Encode(lidar));
  EXPECT_EQ(mapper_->counts().drops[DropReason::kUnusableScan], 1);
  Pose(0);
  Pose(1000, 1);
  lidar.utime = 200'000;
  lidar.num_ranges = 2;
  lidar.ranges = {2, 2};
  lidar.thetas = {static_cast<float>(M_PI / 2), 0};
  lidar.times = {200'000, 300'000};
  lidar.intensities = {0, 0};
  mapper_->HandleMessage("LASER", Encode(lidar));
  EXPECT_GT(Near(0.2, -2), 0.5) << "michigan_2014";
}

TEST_F(MapperTest, AFullMapDropsScansAndKeepsWhatItHas) {
  config_.mutable_service()->set_max_map_mb(1);
  Configure("LASER:bot_core");
  for (int n = 0; n < 1000; ++n) {
    Pose(1000 * n, 10.0 * n);
    ScanLeft(1000 * n);
  }
  EXPECT_GE(layer_.tiles().size(), 512u);
  EXPECT_LT(layer_.tiles().size(), 520u);
  const MapperCounts counts = mapper_->counts();
  EXPECT_EQ(counts.drops[DropReason::kMapFull] + counts.scans_mapped, 1000);
}

// Which scan is the first that does not fit depends on the scans before; and it is said before what
// comes after it.
TEST_F(MapperTest, AMapThatIsMappedBesideIsFullAtTheSameScan) {
  config_.mutable_service()->set_max_map_mb(1);
  std::vector<std::string> said;
  const auto map = [&](bool beside, int64_t garbage_after) {
    layer_.StartEmptySession({2, 2});
    Configure("LASER:bot_core");
    if (beside) mapper_->MapBeside();
    for (int n = 0; n < 1000; ++n) {
      Pose(1000 * n, 10.0 * n);
      ScanLeft(1000 * n);
      if (n == garbage_after) mapper_->HandleMessage("LASER", std::vector<uint8_t>{1, 2, 3});
    }
    mapper_->Flush();
    said.clear();
    for (const Notice& notice : mapper_->DrainNotices()) said.push_back(notice.subject);
    return mapper_->counts().scans_mapped;
  };
  const int64_t mapped = map(false, -1);
  for (const bool beside : {false, true}) {
    EXPECT_EQ(map(beside, mapped), mapped);
    EXPECT_EQ(said, (std::vector<std::string>{"map_full LASER", "wrong_type_of_scan LASER"}));
  }
}

TEST_F(MapperTest, WhoRefusesScansSaysWhy) {
  Configure("LASER:bot_core");
  for (int n = 0; n < 30; ++n) {
    if (n == 10) mapper_->Refuse("the disk is small");
    if (n == 20) mapper_->Refuse("");
    Pose(1000 * n);
    ScanLeft(1000 * n);
  }
  EXPECT_EQ(mapper_->counts().drops[DropReason::kMapFull], 10);
  const std::vector<Notice> notices = mapper_->DrainNotices();
  EXPECT_TRUE(std::any_of(notices.begin(), notices.end(), [](const Notice& notice) {
    return notice.text.find("the disk is small") != std::string::npos;
  }));
}

TEST_F(MapperTest, ATimeJumpNamesItsChannel) {
  Configure("LASER:bot_core");
  Pose(100'000);
  ScanLeft(100'000);
  mapper_->DrainNotices();
  ScanLeft(10'000);
  EXPECT_TRUE(mapper_->DrainNotices().empty()) << "it may be a stray stamp";
  ScanLeft(10'100);
  std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_EQ(notices[0].text.substr(0, 6), "LASER:") << notices[0].text;
  Pose(200'000);
  Pose(20'000);
  Pose(20'100);
  notices = mapper_->DrainNotices();
  ASSERT_FALSE(notices.empty());
  EXPECT_EQ(notices[0].text.substr(0, 5), "POSE:") << notices[0].text;
}

TEST_F(MapperTest, FlushMapsWhatTheOrderHeldBack) {
  Configure("LASER:bot_core");
  *config_.add_scan() = *ParseScanFlag("REAR:bot_core");
  mapper_.emplace(config_, map_.options(), layer_);
  Pose(0);
  Pose(100);
  ScanLeft(50);
  EXPECT_EQ(mapper_->counts().scans_mapped, 0);
  EXPECT_EQ(mapper_->scans_queued(), 1u);
  mapper_->Flush();
  EXPECT_EQ(mapper_->counts().scans_mapped, 1);
}

TEST_F(MapperTest, ScansWithoutUsefulStampsTakeTheTimeOfReception) {
  Configure("LASER:bot_core,stamp=receive");
  for (int n = 0; n < 10; ++n) {
    Pose(100 * n, 0.1 * n);
    mapper_->HandleMessage("LASER", Encode(PlanarLidarMessage(Utime(0), {2}, M_PI / 2, 0)),
                           std::chrono::milliseconds(100 * n));
  }
  EXPECT_EQ(mapper_->counts().scans_mapped, 10);
  EXPECT_GT(Near(0.9, 2), 0.5);
}

TEST_F(MapperTest, OddReadingsAreSaidWithTheFlagThatMends) {
  Configure("LASER:bot_core");
  std::vector<float> ranges_m(90);
  for (size_t k = 0; k < ranges_m.size(); ++k) ranges_m[k] = 31 + 0.3F * static_cast<float>(k);
  for (int n = 0; n < 60; ++n) {
    Pose(100 * n, 0.1 * n);
    mapper_->HandleMessage(
        "LASER", Encode(PlanarLidarMessage(std::chrono::milliseconds(100 * n), ranges_m, 0, 0.05)));
  }
  EXPECT_GE(Problems(Problem::kOddReadings), 1);
  const std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_NE(notices[0].text.find("--scan LASER:bot_core,range_max_m="), std::string::npos)
      << notices[0].text;
  EXPECT_EQ(mapper_->counts().beams_received, 60 * 90);
  EXPECT_EQ(mapper_->counts().beams_mapped, 0);
}

TEST_F(MapperTest, PosesThatJumpAreSaidWithBoth) {
  Configure("LASER:bot_core");
  Pose(0, 1);
  Pose(100, 500);
  EXPECT_EQ(Problems(Problem::kPoseJump), 1);
  const std::vector<Notice> notices = mapper_->DrainNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_NE(notices[0].text.find("from (1.0, 0.0) m to (500.0, 0.0) m in 0.100 s"),
            std::string::npos)
      << notices[0].text;
}

// A new drive would soon have overwritten what it contradicts.
TEST_F(MapperTest, AMapThatIsContinuedInAnotherFrameIsSaid) {
  Configure("LASER:bot_core");
  const auto drive = [&](int64_t begin_ms, float range_m) {
    for (int n = 0; n < 40; ++n) {
      const int64_t ms = begin_ms + 100 * n;
      Pose(ms, 0.01 * n);
      mapper_->HandleMessage("LASER",
                             Encode(PlanarLidarMessage(std::chrono::milliseconds(ms),
                                                       std::vector<float>(90, range_m), 0, 0.07)));
    }
  };
  drive(0, 4);
  for (const float range_m : {4.F, 2.F}) {
    mapper_.emplace(config_, map_.options(), layer_);
    drive(100'000, range_m);
    EXPECT_EQ(Problems(Problem::kMapDisagrees) > 0, range_m != 4) << range_m;
  }
}

}  // namespace splinemap::mapper_test
