#include "lib/diagnosis/sensor_option_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/support/room_drive.h"

namespace splinemap::sensor_option_search_test {

using std::chrono::milliseconds;

RecordingSample Drive(const RoomDriver& driver, double turn = 1) {
  DriveCollector collector(60, 200);
  DriveInRoom(
      driver, turn, [&](const TimedPose& pose) { collector.AddPose(pose); },
      [&](RangeReadings readings) { collector.AddScan(std::move(readings), Utime(0)); });
  return collector.sample();
}

TEST(SensorOptionSearchTest, RightFlagsStay) {
  SensorOptions given;
  given.scan_duration = milliseconds(100);
  const auto proposal = SearchFlags(Drive({}), given);
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->spread, proposal->spread_given);
  EXPECT_EQ(proposal->options.bearing_sign, 1);
  EXPECT_EQ(proposal->options.time_offset, Utime(0));
  EXPECT_GT(proposal->spread_flipped, 2 * proposal->spread);
}

TEST(SensorOptionSearchTest, AWrongSignIsFound) {
  SensorOptions given;
  given.scan_duration = milliseconds(100);
  const auto proposal = SearchFlags(Drive({.sign = -1}), given);
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.bearing_sign, -1);
  EXPECT_LT(proposal->spread, 0.5 * proposal->spread_given);
}

TEST(SensorOptionSearchTest, ASensorThatLooksBackwardsIsFound) {
  SensorOptions given;
  given.scan_duration = milliseconds(100);
  const auto proposal = SearchFlags(Drive({.yaw_rad = std::numbers::pi}), given);
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.bearing_sign, 1);
  EXPECT_NEAR(std::abs(WrapAngle(proposal->options.mount.robot_T_sensor.yaw_rad)), std::numbers::pi,
              1e-9);
}

// Of a sensor of one instant, on a robot whose driver says nothing of where it sits.
RecordingSample DriveWithSensorAt(const Pose2& robot_T_sensor, double stamp_late_s) {
  DriveCollector collector(60, 200);
  DriveInRoom(
      {.stamp_late_s = stamp_late_s, .duration_s = 0}, 1,
      [&](TimedPose pose) {
        // The drive is that of the sensor.
        const double yaw_rad = pose.world_T_robot.yaw_rad - robot_T_sensor.yaw_rad;
        const Pose2 turned{{0, 0}, yaw_rad};
        pose.world_T_robot.position_m -= turned * robot_T_sensor.position_m;
        pose.world_T_robot.yaw_rad = yaw_rad;
        collector.AddPose(pose);
      },
      [&](RangeReadings readings) { collector.AddScan(std::move(readings), Utime(0)); });
  return collector.sample();
}

TEST(SensorOptionSearchTest, ASensorThatSitsAndLooksElsewhereIsFound) {
  for (const double late_s : {0.0, 0.235}) {
    const Pose2 robot_T_sensor{{0.3, -0.2}, 37 * std::numbers::pi / 180};
    const auto proposal = SearchFlags(DriveWithSensorAt(robot_T_sensor, late_s), {});
    ASSERT_TRUE(proposal);
    const Pose2& found = proposal->options.mount.robot_T_sensor;
    EXPECT_NEAR(found.position_m.x(), 0.3, 0.03);
    EXPECT_NEAR(found.position_m.y(), -0.2, 0.03);
    EXPECT_NEAR(found.yaw_rad, robot_T_sensor.yaw_rad, 0.02);
    EXPECT_NEAR(static_cast<double>(proposal->options.time_offset.count()), -1e6 * late_s, 5e3);
  }
}

TEST(SensorOptionSearchTest, ASensorThatSitsNearTheMiddleIsLeftThere) {
  const auto proposal = SearchFlags(DriveWithSensorAt({{0.01, 0.01}, 0}, 0), {});
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.mount.robot_T_sensor.position_m, Eigen::Vector2d(0, 0));
  EXPECT_EQ(proposal->options.mount.robot_T_sensor.yaw_rad, 0);
}

TEST(SensorOptionSearchTest, AnOffsetBetweenTheStepsOfTheSearchIsFoundToTheMillisecond) {
  for (const double late_s : {0.012, 0.387, -0.662}) {
    const auto proposal = SearchFlags(DriveWithSensorAt({}, late_s), {});
    ASSERT_TRUE(proposal);
    EXPECT_NEAR(static_cast<double>(proposal->options.time_offset.count()), -1e6 * late_s, 3e3);
  }
}

TEST(SensorOptionSearchTest, LateStampsAndASlowSensorAreFound) {
  const auto proposal = SearchFlags(Drive({.stamp_late_s = 0.3}), SensorOptions());
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.time_offset, milliseconds(-300));
  EXPECT_EQ(proposal->options.scan_duration, milliseconds(100));
}

TEST(SensorOptionSearchTest, StampsBeyondTheSearchAreSaidToBe) {
  const auto proposal = SearchFlags(Drive({.stamp_late_s = 1.4}), SensorOptions());
  ASSERT_TRUE(proposal);
  EXPECT_TRUE(proposal->is_time_beyond);
  EXPECT_FALSE(SearchFlags(Drive({.stamp_late_s = 0.5}), SensorOptions())->is_time_beyond);
}

TEST(SensorOptionSearchTest, ScansWithoutHitsTellNothing) {
  SensorOptions options;
  options.range_min_m = 9;
  EXPECT_FALSE(SearchFlags(Drive({}), options));
}

TEST(SensorOptionSearchTest, BeamTimesThatHelpAreFound) {
  const auto proposal = SearchFlags(Drive({.duration_s = 0.37, .beam_times = true}), {});
  ASSERT_TRUE(proposal);
  EXPECT_TRUE(proposal->options.use_beam_times);
  EXPECT_EQ(proposal->options.time_offset, milliseconds(0));
}

TEST(SensorOptionSearchTest, ARobotThatDoesNotTurnTellsNothing) {
  EXPECT_FALSE(SearchFlags(Drive({}, 0), SensorOptions()));
  EXPECT_FALSE(SearchFlags(RecordingSample(), SensorOptions()));
}

std::string FlagWith(const std::string& given, const std::string& preset,
                     const SensorOptions& options) {
  return ScanFlagOf(ScanWith(*ParseScanFlag(given), preset, options));
}

TEST(ScanWithTest, NamesThePresetThatNeedsTheFewestOptions) {
  SensorOptions options = SensorOptionsOf({}, "michigan_2014");
  EXPECT_EQ(FlagWith("LIDAR", "bot_core", options), "LIDAR:michigan_2014");
  options = SensorOptionsOf({}, "michigan_2017");
  options.time_offset = Utime(-87'500);
  EXPECT_EQ(FlagWith("LIDAR", "bot_core", options), "LIDAR:michigan_2017,time_offset_ms=-87.5");
  options = SensorOptionsOf({}, "bot_core");
  options.mount.robot_T_sensor.yaw_rad = std::numbers::pi;
  EXPECT_EQ(FlagWith("LIDAR", "bot_core", options), "LIDAR:bot_core,yaw_deg=180");
  options = {};
  options.bearing_sign = -1;
  options.time_offset = milliseconds(50);
  EXPECT_EQ(FlagWith("LIDAR", "michigan_2017", options),
            "LIDAR:michigan_2017,time_offset_ms=50,scan_duration_ms=0")
      << "the one at hand where others are as short";
}

TEST(ScanWithTest, KeepsWhatASearchDoesNotChange) {
  const std::string given = "LIDAR:bot_core,bearing_sign=-1,range_max_m=8,mask=1..2,mask=3..4";
  EXPECT_EQ(FlagWith(given, "bot_core", SensorOptionsOf({}, "mbot_2024")),
            "LIDAR:mbot_2024,range_max_m=8,mask=1..2,mask=3..4");
  SensorOptions turned;
  turned.mount.robot_T_sensor = {{0.5, 0}, 1};
  EXPECT_EQ(FlagWith("LIDAR", "bot_core", turned), "LIDAR:bot_core,x_m=0.5,yaw_deg=57.29578");
  EXPECT_EQ(FlagWith("LIDAR,extrinsics_channel=MOUNT", "bot_core", turned),
            "LIDAR:bot_core,extrinsics_channel=MOUNT");
}

TEST(ScanWithTest, WhatItWritesIsReadBack) {
  SensorOptions options;
  options.bearing_sign = -1;
  options.time_offset = Utime(1'487'296'512'345'000);
  options.scan_duration = milliseconds(-200);
  const auto scan = ParseScanFlag(FlagWith("LIDAR", "mbot_2024", options));
  ASSERT_TRUE(scan.ok()) << scan.status();
  const SensorOptions read = SensorOptionsOf(*scan, scan->preset());
  EXPECT_EQ(read.bearing_sign, -1);
  EXPECT_EQ(read.time_offset, options.time_offset);
  EXPECT_EQ(read.scan_duration, options.scan_duration);
}

}  // namespace splinemap::sensor_option_search_test
