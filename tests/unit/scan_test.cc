#include "splinemap/scan.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "Eigen/Geometry"

namespace splinemap::scan_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

RangeReadings Readings(std::vector<float> ranges_m) {
  RangeReadings readings;
  readings.utime = seconds(100);
  for (size_t k = 0; k < ranges_m.size(); ++k) {
    readings.bearings_rad.push_back(0.1F * static_cast<float>(k));
  }
  readings.ranges_m = std::move(ranges_m);
  return readings;
}

TEST(PrepareScanTest, BeamsThatSayNothingAreLeftOut) {
  const float infinity = std::numeric_limits<float>::infinity();
  const auto scan = PrepareScan(
      Readings({std::nanf(""), -1, 0, 0.049F, 30, infinity, -infinity, 81.83F, 2.5F}), {}, 3);
  ASSERT_TRUE(scan.ok());
  ASSERT_EQ(scan->beams.size(), 1u);
  EXPECT_EQ(scan->beams[0].range_m, 2.5F);
  EXPECT_FLOAT_EQ(scan->beams[0].bearing_rad, 0.8F);
  EXPECT_TRUE(scan->beams[0].hit);
  EXPECT_EQ(scan->channel, 3);
}

TEST(PrepareScanTest, NoReturnClearsUpToTheMaximumWhereConfigured) {
  SensorOptions options;
  options.range_max_m = 8;
  options.no_return_is_free = true;
  const float infinity = std::numeric_limits<float>::infinity();
  const auto scan =
      PrepareScan(Readings({0, infinity, 8, 50, -1, 0.01F, std::nanf("")}), options, 0);
  ASSERT_EQ(scan->beams.size(), 4u);
  for (const Beam& beam : scan->beams) {
    EXPECT_FALSE(beam.hit);
    EXPECT_EQ(beam.range_m, 8);
  }
}

TEST(PrepareScanTest, SmallNumbersThatMeanNoReturnAreConfigured) {
  SensorOptions options;
  options.no_return_up_to_m = 0.01;
  options.no_return_is_free = true;
  const auto scan = PrepareScan(Readings({0.01F, 0.02F, 0, -0.01F, 1}), options, 0);
  ASSERT_EQ(scan->beams.size(), 3u) << "0.02 is too short, and negative says nothing";
  EXPECT_FALSE(scan->beams[0].hit);
  EXPECT_FALSE(scan->beams[1].hit);
  EXPECT_TRUE(scan->beams[2].hit);
}

TEST(PrepareScanTest, MaskedBearingsAreLeftOutAcrossTheSeamToo) {
  constexpr double kDegree = std::numbers::pi / 180;
  RangeReadings readings = Readings(std::vector<float>(36, 1));
  for (int k = 0; k < 36; ++k) readings.bearings_rad[k] = static_cast<float>(k * 10 * kDegree);
  SensorOptions options;
  options.masks = {{155 * kDegree, 50 * kDegree}, {-5 * kDegree, 10 * kDegree}};
  const auto scan = PrepareScan(readings, options, 0);
  EXPECT_EQ(scan->beams.size(), 30u) << "160 .. 200 and 0 are gone";
  options.masks = {{25 * kDegree, 10 * kDegree}};
  options.bearing_sign = -1;
  const auto flipped = PrepareScan(readings, options, 0);
  for (const Beam& beam : flipped->beams) {
    EXPECT_GT(std::abs(WrapAngle(beam.bearing_rad - 30 * kDegree)), 1 * kDegree)
        << "after bearing_sign";
  }
  EXPECT_EQ(flipped->beams.size(), 35u);
}

TEST(PrepareScanTest, DecimationKeepsBearingsAndTimes) {
  SensorOptions options;
  options.every_nth_beam = 2;
  options.scan_duration = milliseconds(100);
  const auto scan = PrepareScan(Readings({1, 2, 3, 4, 5}), options, 0);
  ASSERT_EQ(scan->beams.size(), 3u);
  EXPECT_EQ(scan->beams[1].range_m, 3);
  EXPECT_FLOAT_EQ(scan->beams[1].bearing_rad, 0.2F);
  EXPECT_EQ(scan->beams[1].time_offset, milliseconds(50));
}

TEST(PrepareScanTest, UpsideDownTurnsTheScanOver) {
  SensorOptions options;
  options.mount.is_upside_down = true;
  EXPECT_FLOAT_EQ(PrepareScan(Readings({1, 1}), options, 0)->beams[1].bearing_rad, -0.1F);
}

TEST(BeamTimesTest, AreUsefulWhereTheyDifferAndAreNear) {
  RangeReadings readings = Readings({1, 1});
  EXPECT_FALSE(HaveUsefulBeamTimes(readings)) << "none";
  readings.beam_utimes = {seconds(100), seconds(100) + milliseconds(9)};
  EXPECT_FALSE(HaveUsefulBeamTimes(readings)) << "all the same";
  readings.beam_utimes[1] = seconds(100) + milliseconds(150);
  EXPECT_TRUE(HaveUsefulBeamTimes(readings));
  readings.beam_utimes[1] = Utime::max();
  EXPECT_FALSE(HaveUsefulBeamTimes(readings)) << "uninitialised";
}

TEST(PrepareScanTest, AReadingOfTheMaximumIsNoReturnWhateverItsRounding) {
  for (const double range_max_m : {5.6, 4.095, 8.2, 12.0}) {
    SensorOptions options;
    options.range_max_m = range_max_m;
    EXPECT_TRUE(PrepareScan(Readings({static_cast<float>(range_max_m)}), options, 0)->beams.empty())
        << range_max_m;
  }
}

TEST(PrepareScanTest, BearingSignTurnsTheScan) {
  SensorOptions options;
  options.bearing_sign = -1;
  const auto scan = PrepareScan(Readings({1, 1, 1}), options, 0);
  EXPECT_FLOAT_EQ(scan->beams[2].bearing_rad, -0.2F);
}

TEST(PrepareScanTest, ABeamOfUndefinedBearingIsLeftOut) {
  RangeReadings readings = Readings({1, 1});
  readings.bearings_rad[0] = std::nanf("");
  EXPECT_EQ(PrepareScan(readings, {}, 0)->beams.size(), 1u);
}

TEST(PrepareScanTest, DurationSpreadsTheBeamsFromFirstToLast) {
  SensorOptions options;
  options.time_offset = milliseconds(-150);
  options.scan_duration = milliseconds(100);
  const auto scan = PrepareScan(Readings({1, 1, 1, 1, 1}), options, 0);
  EXPECT_EQ(scan->utime, seconds(100) - milliseconds(150));
  EXPECT_EQ(scan->beams.front().time_offset, milliseconds(0));
  EXPECT_EQ(scan->beams[1].time_offset, milliseconds(25));
  EXPECT_EQ(scan->last_beam, milliseconds(100));
  options.scan_duration = milliseconds(-100);
  EXPECT_EQ(PrepareScan(Readings({1, 1}), options, 0)->first_beam, milliseconds(-100));
}

TEST(PrepareScanTest, BeamTimesComeFromTheMessage) {
  SensorOptions options;
  options.use_beam_times = true;
  RangeReadings readings = Readings({1, 1});
  readings.beam_utimes = {seconds(100), seconds(100) + milliseconds(70)};
  EXPECT_EQ(PrepareScan(readings, options, 0)->beams[1].time_offset, milliseconds(70));
}

TEST(PrepareScanTest, BeamTimesThatCannotBeTrueAreRefused) {
  SensorOptions options;
  options.use_beam_times = true;
  RangeReadings readings = Readings({1, 1});
  EXPECT_FALSE(PrepareScan(readings, options, 0).ok()) << "none";
  readings.beam_utimes = {seconds(100), seconds(5)};
  EXPECT_FALSE(PrepareScan(readings, options, 0).ok()) << "95 s earlier";
  readings.beam_utimes[1] = Utime::min();
  EXPECT_FALSE(PrepareScan(readings, options, 0).ok()) << "uninitialised";
}

TEST(PrepareScanTest, MoreBeamsThanTheLimitAreRefused) {
  EXPECT_TRUE(PrepareScan(Readings(std::vector<float>(kMaxBeams, 1)), {}, 0).ok());
  EXPECT_FALSE(PrepareScan(Readings(std::vector<float>(kMaxBeams + 1, 1)), {}, 0).ok());
}

TEST(PrepareScanTest, NoBeamAndOneBeamAreScansToo) {
  SensorOptions options;
  options.scan_duration = milliseconds(100);
  EXPECT_TRUE(PrepareScan(Readings({}), options, 0)->beams.empty());
  EXPECT_EQ(PrepareScan(Readings({1}), options, 0)->last_beam, milliseconds(0));
}

TEST(PrepareScanTest, AFieldOfViewStretchesBearings) {
  RangeReadings readings;
  for (int k = 0; k < 360; ++k) {
    readings.ranges_m.push_back(2);
    readings.bearings_rad.push_back(
        static_cast<float>(-std::numbers::pi / 2 + k * std::numbers::pi / 360));
  }
  EXPECT_NEAR(FieldOfView(readings.bearings_rad), std::numbers::pi, 1e-6);
  SensorOptions options;
  options.field_of_view_rad = 2 * std::numbers::pi;
  const auto scan = PrepareScan(readings, options, 0);
  ASSERT_TRUE(scan.ok());
  EXPECT_NEAR(scan->beams[0].bearing_rad, -std::numbers::pi, 1e-5);
  EXPECT_NEAR(scan->beams[1].bearing_rad - scan->beams[0].bearing_rad, std::numbers::pi / 180,
              1e-5);
  EXPECT_NEAR(FieldOfView(std::vector<float>(readings.bearings_rad.begin(),
                                             readings.bearings_rad.begin() + 5)),
              4 * std::numbers::pi / 360, 1e-6);
  EXPECT_EQ(FieldOfView(std::vector<float>{0, 1, 5}), 0) << "no equal steps";
  EXPECT_EQ(FieldOfView(std::vector<float>{0}), 0);
}

TEST(AtTest, BeamTimesGoWithTheScan) {
  RangeReadings readings = Readings({1, 2, 3});
  readings.beam_utimes = {seconds(100), seconds(101), Utime::min()};
  const RangeReadings later = At(readings, seconds(500));
  EXPECT_EQ(later.utime, seconds(500));
  EXPECT_EQ(later.beam_utimes, (std::vector<Utime>{seconds(500), seconds(501), seconds(500)}));
}

// Against the rotation matrix Rz(yaw) Ry(pitch) Rx(roll).
TEST(TiltTest, BeamsAreThoseOfTheRotatedPlaneSeenFromAbove) {
  for (const double roll : {0.0, 0.12, -0.1, std::numbers::pi, std::numbers::pi - 0.1}) {
    for (const double pitch : {0.0, 0.09, -0.15}) {
      const double yaw = 0.7;
      const double sensor_yaw = 0.4;
      const Eigen::Matrix3d world_R_robot = (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) *
                                             Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
                                             Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
                                                .toRotationMatrix();
      std::vector<Beam> beams;
      for (int k = -6; k < 6; ++k)
        beams.push_back({5, 0.5F * static_cast<float>(k), Utime(0), true});
      std::vector<Beam> leveled = beams;
      Level(sensor_yaw, world_R_robot.row(2).transpose(), absl::MakeSpan(leveled));
      std::vector<PlacedBeam> placed;
      Place(leveled, std::vector<Pose2>{{{1, 2}, yaw + sensor_yaw}}, placed);
      for (size_t k = 0; k < beams.size(); ++k) {
        const double theta = sensor_yaw + beams[k].bearing_rad;
        const Eigen::Vector3d end =
            world_R_robot * Eigen::Vector3d(5 * std::cos(theta), 5 * std::sin(theta), 0);
        EXPECT_LT((placed[k].range_m * placed[k].direction_world - end.head<2>()).norm(), 1e-3)
            << "roll " << roll << " pitch " << pitch;
        EXPECT_NEAR(placed[k].direction_world.norm(), 1, 1e-9);
      }
    }
  }
}

}  // namespace splinemap::scan_test
