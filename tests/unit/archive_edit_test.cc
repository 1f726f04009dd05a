#include "lib/mapping/archive_edit.h"

#include <gtest/gtest.h>

#include <cmath>

namespace splinemap::archive_edit_test {

// A scan each second, a metre further along x.
ScanArchive StraightDrive(int scans) {
  ScanArchive archive;
  for (int k = 0; k < scans; ++k) {
    auto scan = std::make_shared<PosedScan>();
    scan->utime = std::chrono::seconds(k);
    scan->world_T_robot = FixedPose2::Nearest({{k, 0}, 0});
    scan->robot_T_sensor.resize(1);
    archive.Add(std::move(scan), {});
  }
  return archive;
}

Trajectory TrajectoryOf(std::vector<TrajectoryPose> poses, Utime until = Utime(0)) {
  return {std::move(poses), until};
}

std::vector<Pose2> Corrected(const ScanArchive& archive, const Trajectory& trajectory) {
  const auto edit = CorrectBy(archive, trajectory);
  EXPECT_TRUE(edit.ok()) << edit.status();
  std::vector<Pose2> poses;
  if (!edit.ok()) return poses;
  edit->Apply(archive).ForEachPose(
      [&](const ScanPose& pose) { poses.push_back(pose.world_T_robot.ToPose()); });
  return poses;
}

std::vector<int64_t> TimesOf(const ScanArchive& archive) {
  std::vector<int64_t> times;
  archive.ForEachPose(
      [&](const ScanPose& pose) { times.push_back(pose.utime.count() / 1'000'000); });
  return times;
}

using std::chrono::milliseconds;
using std::chrono::seconds;

TEST(CorrectByTest, ScansAtThePosesGetThemAndThoseBetweenMoveWithBoth) {
  const auto poses = Corrected(
      StraightDrive(7), TrajectoryOf({{seconds(1), {{1, 0}, 0}}, {seconds(5), {{5, 4}, 0}}}));
  EXPECT_EQ(poses[0].position_m, Eigen::Vector2d(0, 0)) << "before the first";
  EXPECT_EQ(poses[1].position_m, Eigen::Vector2d(1, 0));
  EXPECT_NEAR(poses[2].position_m.y(), 1, 1e-6);
  EXPECT_NEAR(poses[4].position_m.y(), 3, 1e-6);
  EXPECT_NEAR(poses[4].position_m.x(), 4, 1e-6);
  EXPECT_EQ(poses[5].position_m, Eigen::Vector2d(5, 4));
  EXPECT_EQ(poses[6].position_m, Eigen::Vector2d(6, 0)) << "after the last";
}

TEST(ArchiveEditTest, SaysWhetherItChangesAnything) {
  const ScanArchive archive = StraightDrive(7);
  EXPECT_FALSE(ArchiveEdit().Changes(archive));
  const Trajectory trajectory = TrajectoryOf({{seconds(3), {{0, 0}, M_PI / 2}}}, seconds(6));
  const ArchiveEdit corrected = *CorrectBy(archive, trajectory);
  EXPECT_TRUE(corrected.Changes(archive));
  const ScanArchive once = corrected.Apply(archive);
  EXPECT_FALSE(CorrectBy(once, trajectory)->Changes(once)) << "said again";
  EXPECT_TRUE(ForgetBefore(archive, seconds(1))->Changes(archive));
  EXPECT_FALSE(ForgetBefore(archive, seconds(0))->Changes(archive));
  ArchiveEdit placed;
  placed.map_T_world = FixedPose2();
  EXPECT_FALSE(placed.Changes(archive));
  placed.map_T_world->x = 1;
  EXPECT_TRUE(placed.Changes(archive));
  ScanArchive with_base = archive;
  TileTreeEditor base;
  base.Edit({0, 0}, 1).Edit().control_points[0] = 1;
  with_base.base.tiles = base.Freeze();
  ArchiveEdit without_base;
  without_base.keeps_base = false;
  EXPECT_TRUE(without_base.Changes(with_base));
  EXPECT_FALSE(without_base.Changes(archive));
}

TEST(CorrectByTest, WhatComesAfterTheLastPoseMovesWithItUntilTheLocalisationIsRight) {
  const auto poses =
      Corrected(StraightDrive(7), TrajectoryOf({{seconds(3), {{0, 0}, M_PI / 2}}}, seconds(6)));
  EXPECT_NEAR(poses[5].position_m.x(), 0, 1e-6);
  EXPECT_NEAR(poses[5].position_m.y(), 2, 1e-6) << "2 m ahead, turned as the pose is";
  EXPECT_NEAR(poses[5].yaw_rad, M_PI / 2, 1e-6);
  EXPECT_EQ(poses[6].position_m, Eigen::Vector2d(6, 0));
  EXPECT_EQ(poses[2].position_m, Eigen::Vector2d(2, 0));
}

TEST(CorrectByTest, PosesBetweenScansAreComparedWithThePathBetweenThem) {
  const auto poses = Corrected(
      StraightDrive(6),
      TrajectoryOf({{milliseconds(500), {{0.5, 2}, 0}}, {milliseconds(4500), {{4.5, 2}, 0}}}));
  for (int k = 1; k <= 4; ++k) {
    EXPECT_NEAR(poses[k].position_m.x(), k, 1e-6);
    EXPECT_NEAR(poses[k].position_m.y(), 2, 1e-6);
  }
}

TEST(CorrectByTest, ATrajectoryLongerThanTheDriveMovesAllOfIt) {
  const auto poses = Corrected(StraightDrive(4), TrajectoryOf({{Utime(-2'000'000), {{-2, 5}, 0}},
                                                               {seconds(2), {{2, 1}, 0}},
                                                               {seconds(9), {{9, 1}, 0}}}));
  EXPECT_NEAR(poses[1].position_m.y(), 1, 1e-6) << "moves with the only pose that is known";
  EXPECT_NEAR(poses[3].position_m.y(), 1, 1e-6);
}

TEST(CorrectByTest, TheSameAgainChangesNothing) {
  const ScanArchive archive = StraightDrive(300);
  const Trajectory trajectory =
      TrajectoryOf({{seconds(10), {{9, 1}, 0.1}}, {seconds(200), {{190, -7}, -0.2}}}, seconds(250));
  const ScanArchive once = CorrectBy(archive, trajectory)->Apply(archive);
  const ScanArchive twice = CorrectBy(once, trajectory)->Apply(once);
  std::vector<FixedPose2> first, second;
  once.ForEachPose([&](const ScanPose& pose) { first.push_back(pose.world_T_robot); });
  twice.ForEachPose([&](const ScanPose& pose) { second.push_back(pose.world_T_robot); });
  for (size_t k = 0; k < first.size(); ++k) {
    EXPECT_LT((first[k].ToPose().position_m - second[k].ToPose().position_m).norm(), 5e-6);
  }
}

TEST(CorrectByTest, AnotherClockIsNamed) {
  const absl::Status status =
      CorrectBy(StraightDrive(5), TrajectoryOf({{seconds(100), {}}, {seconds(101), {}}})).status();
  EXPECT_TRUE(absl::IsNotFound(status));
  EXPECT_NE(status.message().find("clock of the scans"), std::string::npos);
}

TEST(CorrectByTest, WhatTheBaseHasOfThatTimeCannotBeMoved) {
  ScanArchive archive = StraightDrive(5);
  TileTreeEditor tiles;
  tiles.Edit({0, 0}, 1).Edit().control_points.fill(5);
  archive.base = {tiles.Freeze(), {}, 70, seconds(2)};
  EXPECT_TRUE(absl::IsFailedPrecondition(
      CorrectBy(archive, TrajectoryOf({{seconds(1), {}}, {seconds(3), {}}})).status()));
  EXPECT_TRUE(CorrectBy(archive, TrajectoryOf({{seconds(3), {}}, {seconds(4), {}}})).ok());
}

TEST(CheckTrajectoryTest, StampsIncreaseAndNumbersCanBe) {
  EXPECT_FALSE(CheckTrajectory({}).ok());
  EXPECT_TRUE(CheckTrajectory(TrajectoryOf({{seconds(1), {}}, {seconds(2), {}}})).ok());
  EXPECT_FALSE(CheckTrajectory(TrajectoryOf({{seconds(1), {}}, {seconds(1), {}}})).ok());
  EXPECT_FALSE(CheckTrajectory(TrajectoryOf({{seconds(1), {{NAN, 0}, 0}}})).ok());
  EXPECT_FALSE(CheckTrajectory(TrajectoryOf({{seconds(1), {{0, 1e12}, 0}}})).ok());
  EXPECT_FALSE(CheckTrajectory(TrajectoryOf({{seconds(1), {{0, 0}, INFINITY}}})).ok());
}

TEST(ForgetBeforeTest, LeavesTheScansSince) {
  ScanArchive archive = StraightDrive(6);
  EXPECT_EQ(TimesOf(ForgetBefore(archive, seconds(4))->Apply(archive)),
            (std::vector<int64_t>{4, 5}));
  TileTreeEditor tiles;
  tiles.Edit({0, 0}, 1).Edit().control_points.fill(5);
  archive.base = {tiles.Freeze(), {}, 70, seconds(2)};
  EXPECT_TRUE(ForgetBefore(archive, seconds(3))->Apply(archive).base.IsEmpty());
  EXPECT_TRUE(absl::IsFailedPrecondition(ForgetBefore(archive, seconds(2)).status()));
  // Nobody knows how old it is, but that the scans of 0 s and later came after it.
  archive.base.newest = Utime(0);
  EXPECT_TRUE(ForgetBefore(archive, seconds(0))->Apply(archive).base.IsEmpty());
  EXPECT_FALSE(ForgetBefore(archive, Utime(-1)).ok());
}

TEST(WindBackToTest, LeavesTheScansBefore) {
  ScanArchive archive = StraightDrive(6);
  EXPECT_EQ(TimesOf(WindBackTo(archive, seconds(2))->Apply(archive)),
            (std::vector<int64_t>{0, 1, 2}));
  TileTreeEditor tiles;
  tiles.Edit({0, 0}, 1).Edit().control_points.fill(5);
  archive.base = {tiles.Freeze(), {}, 70, seconds(2)};
  EXPECT_FALSE(WindBackTo(archive, seconds(2))->Apply(archive).base.IsEmpty());
  EXPECT_FALSE(WindBackTo(archive, seconds(1)).ok());
}

}  // namespace splinemap::archive_edit_test
