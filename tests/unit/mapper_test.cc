#include "lib/pipeline/mapper.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "lcmtypes/michigan/lidar_t.hpp"
#include "lib/map/map.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

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

  double At(double x_m, double y_m) { return map_.Snapshot()->Evaluate(x_m, y_m).log_odds; }

  config::Config config_;
  Map map_{{}};
  Layer& layer_ = map_.AddLayer({"robot", 1}, {1, 1});
  std::optional<Mapper> mapper_;
};

TEST_F(MapperTest, ABeamEndsWhereTheSensorSaysIt) {
  Configure("LASER:bot_core,x_m=0.5");
  Pose(0, 1);
  ScanLeft(0);
  EXPECT_GT(At(1.5, 2), 0.5);
  EXPECT_LT(At(1.5, 1), -0.2);
  EXPECT_EQ(mapper_->counts().scans_mapped, 1);
  EXPECT_EQ(mapper_->counts().beams_mapped, 1);
  EXPECT_EQ(mapper_->newest_scan_utime(), Utime(0));
}

TEST_F(MapperTest, TheSignOfBearingMirrorsTheScan) {
  Configure("LASER:bot_core,bearing_sign=-1");
  Pose(0);
  ScanLeft(0);
  EXPECT_GT(At(0, -2), 0.5);
}

TEST_F(MapperTest, TimeOffsetMovesTheScanAlongThePath) {
  Configure("LASER:bot_core,time_offset_ms=-200");
  Pose(0, 0);
  Pose(1000, 1);
  ScanLeft(700);
  EXPECT_GT(At(0.5, 2), 0.5);
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
  EXPECT_GT(At(0.1, -2), 0.5);
  EXPECT_GT(At(0.6, -2), 0.5);
  ASSERT_EQ(mapper_->TakeNotices().size(), 1u);
  EXPECT_TRUE(mapper_->TakeNotices().empty());
}

TEST_F(MapperTest, WhatCannotBeUsedIsCountedAndSaidOnce) {
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
  EXPECT_EQ(counts.drops[DropReason::kMalformedScan], 3);
  EXPECT_EQ(counts.drops[DropReason::kMalformedPose], 3);
  EXPECT_EQ(counts.drops[DropReason::kPoseOutOfRange], 3);
  EXPECT_EQ(counts.drops[DropReason::kDuplicatePose], 1);
  EXPECT_EQ(counts.drops.Total(), 10);
  EXPECT_EQ(counts.messages_received, 11);
  EXPECT_EQ(counts.scans_received, 3);
  EXPECT_EQ(counts.poses_received, 8);
  EXPECT_EQ(mapper_->TakeNotices().size(), 4u);
  EXPECT_EQ(layer_.revision(), 0u);
}

TEST_F(MapperTest, PosesAtTheEdgeOfTheRangeAreMappedSafely) {
  Configure("LASER:bot_core");
  const double edge_m = 0.9 * kMaxKnotIndex * 0.05 - 1;
  Pose(0, edge_m);
  ScanLeft(0);
  EXPECT_GT(At(edge_m, 2), 0.5);
}

TEST_F(MapperTest, ALocalisationThatFallsSilentIsSaidEachTime) {
  Configure("LASER:bot_core");
  ScanLeft(0);
  Pose(10);
  int64_t ms = 100;
  for (int time = 1; time <= 2; ++time) {
    Pose(ms);
    ScanLeft(ms);
    mapper_->TakeNotices();
    for (int n = 0; n < 60; ++n) ScanLeft(ms += 100);
    const std::vector<Notice> notices = mapper_->TakeNotices();
    ASSERT_EQ(notices.size(), 1u);
    EXPECT_TRUE(notices[0].is_problem);
    EXPECT_NE(notices[0].text.find("does POSE come"), std::string::npos) << notices[0].text;
    ms += 100;
  }
  EXPECT_EQ(mapper_->counts().scans_mapped, 2);
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
  EXPECT_GT(At(0.2, -2), 0.5) << "michigan_2014";
}

TEST_F(MapperTest, AFullMapDropsScansAndKeepsWhatItHas) {
  config_.mutable_service()->set_max_map_mb(1);
  Configure("LASER:bot_core");
  for (int n = 0; n < 1000; ++n) {
    Pose(n, 10.0 * n);
    ScanLeft(n);
  }
  EXPECT_GE(layer_.tiles().size(), 512u);
  EXPECT_LT(layer_.tiles().size(), 520u);
  const MapperCounts counts = mapper_->counts();
  EXPECT_EQ(counts.drops[DropReason::kMapFull] + counts.scans_mapped, 1000);
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

}  // namespace
}  // namespace splinemap
