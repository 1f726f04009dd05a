#include "lib/diagnosis/flag_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

// A robot that drives and turns in a room of 6 x 4 m; its sensor turns once in 100 ms.
class FlagSearchTest : public testing::Test {
 protected:
  static constexpr int kBeams = 90;

  static Pose2 PoseAt(double time_s) {
    return {{1.2 * std::sin(0.5 * time_s), 0.8 * std::sin(0.8 * time_s)},
            2.5 * std::sin(0.7 * time_s)};
  }

  static double RangeToWall(const Eigen::Vector2d& from, double bearing_rad) {
    const double c = std::cos(bearing_rad);
    const double s = std::sin(bearing_rad);
    const double to_x = c > 0 ? (3 - from.x()) / c : (-3 - from.x()) / c;
    const double to_y = s > 0 ? (2 - from.y()) / s : (-2 - from.y()) / s;
    return std::min(to_x, to_y);
  }

  // How the driver of the sensor distorts what it measures.
  struct Driver {
    int sign = 1;
    double yaw_rad = 0;
    double stamp_late_s = 0;
    double duration_s = 0.1;
    bool beam_times = false;
  };

  static DriveSample Drive(const Driver& driver, double turn = 1) {
    DriveSample sample(60, 200);
    for (int n = 0; n < 3000; ++n) {
      const double time_s = 0.02 * n;
      Pose2 pose = PoseAt(time_s);
      pose.yaw_rad *= turn;
      sample.AddPose({Time(time_s), pose});
      if (n % 10 != 0) continue;
      RangeReadings readings;
      readings.utime = Time(time_s + driver.stamp_late_s);
      for (int k = 0; k < kBeams; ++k) {
        const double beam_s = time_s + driver.duration_s * k / (kBeams - 1);
        Pose2 at = PoseAt(beam_s);
        at.yaw_rad *= turn;
        const double bearing_rad = k * 2 * std::numbers::pi / kBeams;
        readings.bearings_rad.push_back(static_cast<float>(driver.sign * bearing_rad));
        readings.ranges_m.push_back(static_cast<float>(
            RangeToWall(at.position_m, at.yaw_rad + driver.yaw_rad + bearing_rad)));
        if (driver.beam_times) readings.beam_utimes.push_back(Time(beam_s + driver.stamp_late_s));
      }
      sample.AddScan(std::move(readings), Utime(0));
    }
    return sample;
  }

  static Utime Time(double time_s) { return Utime(std::llround((100 + time_s) * 1e6)); }
};

TEST_F(FlagSearchTest, RightFlagsStay) {
  SensorOptions given;
  given.scan_duration = milliseconds(100);
  const auto proposal = SearchFlags(Drive({}), given);
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->spread, proposal->spread_given);
  EXPECT_EQ(proposal->options.bearing_sign, 1);
  EXPECT_EQ(proposal->options.time_offset, Utime(0));
  EXPECT_GT(proposal->spread_flipped, 2 * proposal->spread);
}

TEST_F(FlagSearchTest, AWrongSignIsFound) {
  SensorOptions given;
  given.scan_duration = milliseconds(100);
  const auto proposal = SearchFlags(Drive({.sign = -1}), given);
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.bearing_sign, -1);
  EXPECT_LT(proposal->spread, 0.5 * proposal->spread_given);
}

TEST_F(FlagSearchTest, ASensorThatLooksBackwardsIsFound) {
  SensorOptions given;
  given.scan_duration = milliseconds(100);
  const auto proposal = SearchFlags(Drive({.yaw_rad = std::numbers::pi}), given);
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.bearing_sign, 1);
  EXPECT_NEAR(std::abs(WrapAngle(proposal->options.mount.robot_T_sensor.yaw_rad)), std::numbers::pi,
              1e-9);
}

TEST_F(FlagSearchTest, LateStampsAndASlowSensorAreFound) {
  const auto proposal = SearchFlags(Drive({.stamp_late_s = 0.3}), SensorOptions());
  ASSERT_TRUE(proposal);
  EXPECT_EQ(proposal->options.time_offset, milliseconds(-300));
  EXPECT_EQ(proposal->options.scan_duration, milliseconds(100));
}

TEST_F(FlagSearchTest, BeamTimesThatHelpAreFound) {
  const auto proposal = SearchFlags(Drive({.duration_s = 0.37, .beam_times = true}), {});
  ASSERT_TRUE(proposal);
  EXPECT_TRUE(proposal->options.use_beam_times);
  EXPECT_EQ(proposal->options.time_offset, milliseconds(0));
}

TEST_F(FlagSearchTest, ARobotThatDoesNotTurnTellsNothing) {
  EXPECT_FALSE(SearchFlags(Drive({}, 0), SensorOptions()));
  EXPECT_FALSE(SearchFlags(DriveSample(60, 200), SensorOptions()));
}

TEST_F(FlagSearchTest, ASampleKeepsScansOfDifferentPlacesOnly) {
  DriveSample sample(60, 30);
  for (int n = 0; n < 500; ++n) {
    sample.AddPose({Time(0.1 * n), {}});
    RangeReadings readings;
    readings.utime = Time(0.1 * n);
    readings.ranges_m.assign(100, 1);
    readings.bearings_rad.assign(100, 0);
    sample.AddScan(std::move(readings), Utime(0));
  }
  ASSERT_EQ(sample.scans().size(), 1u) << "it stood still";
  EXPECT_EQ(sample.scans()[0].ranges_m.size(), 25u) << "every fourth of 100 beams";
}

TEST(ScanFlagTest, NamesThePresetThatNeedsTheFewestOptions) {
  SensorOptions options = SensorOptionsOf({}, "michigan_2014");
  EXPECT_EQ(ScanFlag("LIDAR", "bot_core", options), "LIDAR:michigan_2014");
  options = SensorOptionsOf({}, "michigan_2017");
  options.time_offset = Utime(-87'500);
  EXPECT_EQ(ScanFlag("LIDAR", "bot_core", options), "LIDAR:michigan_2017,time_offset_ms=-87.5");
  options = SensorOptionsOf({}, "bot_core");
  options.mount.robot_T_sensor.yaw_rad = std::numbers::pi;
  EXPECT_EQ(ScanFlag("LIDAR", "bot_core", options), "LIDAR:bot_core,yaw_deg=180");
  options = {};
  options.bearing_sign = -1;
  options.time_offset = milliseconds(50);
  EXPECT_EQ(ScanFlag("LIDAR", "michigan_2017", options),
            "LIDAR:michigan_2017,time_offset_ms=50,scan_duration_ms=0")
      << "the one at hand where others are as short";
}

TEST(ScanFlagTest, WhatItWritesIsReadBack) {
  SensorOptions options;
  options.bearing_sign = -1;
  options.time_offset = Utime(1'487'296'512'345'000);
  options.scan_duration = milliseconds(-200);
  const auto scan = ParseScanFlag(ScanFlag("LIDAR", "mbot_2024", options));
  ASSERT_TRUE(scan.ok()) << scan.status();
  const SensorOptions read = SensorOptionsOf(*scan, scan->preset());
  EXPECT_EQ(read.bearing_sign, -1);
  EXPECT_EQ(read.time_offset, options.time_offset);
  EXPECT_EQ(read.scan_duration, options.scan_duration);
}

}  // namespace
}  // namespace splinemap
