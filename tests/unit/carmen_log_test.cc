#include "lib/logs/carmen_log.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <cmath>
#include <fstream>
#include <numbers>

#include "tests/support/temporary_directory.h"

namespace splinemap::carmen_log_test {

void NoProgress(double) {}

class CarmenLogTest : public testing::Test {
 protected:
  absl::StatusOr<CarmenLog> Read(const std::string& text,
                                 std::optional<double> field_of_view_rad = {}) {
    std::ofstream(directory_.File("log"), std::ios::binary) << text;
    return ReadCarmenLog(directory_.File("log"), field_of_view_rad, NoProgress);
  }

  static std::string Flaser(int count, double time_s) {
    std::string line = "FLASER " + std::to_string(count);
    for (int k = 0; k < count; ++k) line += " 1." + std::to_string(k % 10);
    return line + " 1.5 -2.5 0.25 9 9 9 7.0 host " + std::to_string(time_s) + "\n";
  }

  TemporaryDirectory directory_;
};

TEST_F(CarmenLogTest, ReadsFlaserLines) {
  const auto log = Read("# comment\nPARAM x y\n" + Flaser(180, 1.5) + Flaser(361, 2));
  ASSERT_TRUE(log.ok()) << log.status();
  ASSERT_EQ(log->scans.size(), 2u);
  const CarmenScan& scan = log->scans[0];
  EXPECT_EQ(scan.ranges_m.size(), 180u);
  EXPECT_FLOAT_EQ(scan.ranges_m[3], 1.3F);
  EXPECT_EQ(scan.world_T_laser.position_m, Eigen::Vector2d(1.5, -2.5));
  EXPECT_EQ(scan.world_T_laser.yaw_rad, 0.25);
  EXPECT_EQ(scan.time_s, 1.5);
  EXPECT_DOUBLE_EQ(scan.first_bearing_rad, -std::numbers::pi / 2);
  EXPECT_DOUBLE_EQ(scan.bearing_step_rad, std::numbers::pi / 180);
  EXPECT_DOUBLE_EQ(log->scans[1].bearing_step_rad, std::numbers::pi / 360);
}

TEST_F(CarmenLogTest, ReadsRobotLaserLinesWhereThereIsNoFlaser) {
  const std::string line =
      "ROBOTLASER1 4 -1.0 2.0 0.5 81.9 0.01 0 5 1 2 3 4 5 2 7 8 "
      "10 20 0.5 11 21 0.6 0 0 0.3 0.3 1 100.5 host 101.5\n";
  const auto log = Read(line);
  ASSERT_TRUE(log.ok()) << log.status();
  ASSERT_EQ(log->scans.size(), 1u);
  EXPECT_EQ(log->scans[0].first_bearing_rad, -1);
  EXPECT_EQ(log->scans[0].bearing_step_rad, 0.5);
  EXPECT_EQ(log->scans[0].ranges_m.size(), 5u);
  EXPECT_EQ(log->scans[0].world_T_laser.position_m, Eigen::Vector2d(10, 20));
  EXPECT_EQ(log->scans[0].time_s, 101.5);
  EXPECT_EQ(Read(line + Flaser(180, 1))->scans[0].ranges_m.size(), 180u) << "FLASER goes first";
}

TEST_F(CarmenLogTest, ReadsTheKindOfLinesOfWhichThereAreMore) {
  const std::string robot_laser =
      "ROBOTLASER1 4 -1.0 2.0 0.5 81.9 0.01 0 2 1 2 0 10 20 0.5 11 21 0.6 0 0 0.3 0.3 1 1 h 1\n";
  const auto log = Read(Flaser(180, 1) + robot_laser + robot_laser);
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_EQ(log->kind, "ROBOTLASER1");
  EXPECT_EQ(log->scans.size(), 2u);
  EXPECT_EQ(log->other_scans, 1);
}

TEST_F(CarmenLogTest, AnyLineEndsIndentationTabsAndAByteOrderMarkAreRead) {
  for (const std::string end : {"\n", "\r\n", "\r"}) {
    std::string text = "\xEF\xBB\xBF" + Flaser(20, 1) + "\t " + Flaser(20, 2) + Flaser(20, 3);
    std::string changed;
    for (const char c : text) changed += c == '\n' ? end : c == ' ' ? "\t" : std::string(1, c);
    const auto log = Read(changed);
    ASSERT_TRUE(log.ok()) << log.status();
    EXPECT_EQ(log->scans.size(), 3u);
    EXPECT_EQ(log->broken_lines, 0);
    EXPECT_EQ(log->scans[2].time_s, 3);
  }
}

TEST_F(CarmenLogTest, ReadingsAtTheMaximumThatALineNamesAreNoReturns) {
  const auto log =
      Read("ROBOTLASER1 4 -1.0 2.0 0.5 8.0 0.01 0 3 7.9 8.0 9 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1\n");
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_FLOAT_EQ(log->scans[0].ranges_m[0], 7.9F);
  EXPECT_TRUE(std::isinf(log->scans[0].ranges_m[1]));
  EXPECT_TRUE(std::isinf(log->scans[0].ranges_m[2]));
  const auto flaser = Read("PARAM robot_front_laser_max 1.5 h 0\n" + Flaser(20, 1));
  ASSERT_TRUE(flaser.ok()) << flaser.status();
  EXPECT_FLOAT_EQ(flaser->scans[0].ranges_m[4], 1.4F);
  EXPECT_TRUE(std::isinf(flaser->scans[0].ranges_m[5]));
}

TEST_F(CarmenLogTest, TheFieldOfViewIsThatOfParametersKnownScannersOrTheUser) {
  struct Case {
    std::string parameters;
    int readings;
    double from_deg;
    double step_deg;
    bool is_guessed;
  };
  const std::string fov = "PARAM laser_front_laser_fov ";
  const std::string resolution = "PARAM laser_front_laser_resolution ";
  for (const Case& c :
       {Case{"", 180, -90, 1, true}, Case{"", 401, -50, 0.25, false},
        Case{"", 1081, -135, 0.25, false}, Case{fov + "100 h 0\n", 401, -50, 0.25, false},
        Case{fov + "3.14159 h 0\n", 361, -90, 0.5, false},
        Case{fov + "360 h 0\n", 360, -180, 1, false},
        Case{resolution + "0.5 h 0\n", 360, -90, 0.5, false},
        Case{resolution + "1 h 0\n", 360, -180, 1, false},
        Case{fov + "nonsense h 0\n", 180, -90, 1, true}}) {
    const auto log = Read(c.parameters + Flaser(c.readings, 1));
    ASSERT_TRUE(log.ok()) << log.status();
    const double degree = std::numbers::pi / 180;
    EXPECT_DOUBLE_EQ(log->scans[0].first_bearing_rad, c.from_deg * degree) << c.parameters;
    EXPECT_DOUBLE_EQ(log->scans[0].bearing_step_rad, c.step_deg * degree) << c.parameters;
    EXPECT_EQ(log->field_of_view_is_guessed, c.is_guessed) << c.parameters;
  }
  const auto told = Read(fov + "100 h 0\n" + Flaser(360, 1), 2 * std::numbers::pi);
  ASSERT_TRUE(told.ok());
  EXPECT_DOUBLE_EQ(told->scans[0].first_bearing_rad, -std::numbers::pi);
}

TEST_F(CarmenLogTest, TheClockThatWasSetCounts) {
  const std::string scan = "FLASER 1 1 0 0 0 0 0 0 ";
  EXPECT_EQ(Read(scan + "5 h 0\n" + scan + "6 h 0\n")->scans[1].time_s, 6);
  EXPECT_EQ(Read(scan + "9 h 5\n" + scan + "9 h 6\n")->scans[1].time_s, 6);
  EXPECT_EQ(Read(scan + "5\n" + scan + "6\n")->scans[1].time_s, 6);
  EXPECT_EQ(Read(scan + "\n" + scan + "\n")->broken_lines, 0);
}

TEST_F(CarmenLogTest, RawScansAreWhereOdometrySays) {
  const std::string scan = "RAWLASER1 0 -1.5 3 0.5 30 0.01 0 2 4 5 0 ";
  const auto log = Read(scan + "1 h 0\nODOM 1 2 0.5 0 0 0 2 h 0\n" + scan + "2.25 h 0\n" +
                        "ODOM 2 4 0.7 0 0 0 3 h 0\n" + scan + "4 h 0\n");
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_EQ(log->kind, "RAWLASER1");
  EXPECT_EQ(log->scans_without_pose, 1);
  ASSERT_EQ(log->scans.size(), 2u);
  EXPECT_TRUE(log->scans[0].world_T_laser.position_m.isApprox(Eigen::Vector2d(1.25, 2.5)));
  EXPECT_DOUBLE_EQ(log->scans[0].world_T_laser.yaw_rad, 0.55);
  EXPECT_EQ(log->scans[1].world_T_laser.position_m, Eigen::Vector2d(2, 4));
}

TEST_F(CarmenLogTest, WhyALogHasNoScansIsSaid) {
  const auto why = [&](const std::string& text) {
    return std::string(Read(text).status().message());
  };
  EXPECT_NE(why("LASER_READING 1 1 0 0 0 1\n").find("gfs2log"), std::string::npos);
  EXPECT_NE(why("RAWLASER1 0 -1.5 3 0.5 30 0.01 0 1 4 0 1 h 1\n").find("no ODOM line"),
            std::string::npos);
  EXPECT_NE(why("\n FLASER 3 1 2\n").find("the first is line 2"), std::string::npos);
}

TEST_F(CarmenLogTest, LinesThatAreBrokenAreSkippedAndCounted) {
  const std::string whole = Flaser(20, 3);
  const auto log = Read(whole + whole.substr(0, 40) + "\nFLASER x\nFLASER 99999999 1\n" +
                        "FLASER -1 1 1 1 1 1 1 1 h 1\nFLASER 1 1 nan 0 0 0 0 0 1 h 1\n" + whole);
  ASSERT_TRUE(log.ok());
  EXPECT_EQ(log->scans.size(), 2u);
  EXPECT_EQ(log->broken_lines, 5);
  EXPECT_EQ(log->first_broken_line, 2);
}

TEST_F(CarmenLogTest, AFileWithoutScansIsRefused) {
  EXPECT_TRUE(absl::IsInvalidArgument(Read("hello\n").status()));
  EXPECT_TRUE(absl::IsInvalidArgument(Read("").status()));
  EXPECT_TRUE(
      absl::IsNotFound(ReadCarmenLog(directory_.File("none"), std::nullopt, NoProgress).status()));
}

TEST_F(CarmenLogTest, ReadsGzipAndSaysWhenItEndsEarly) {
  std::string text;
  for (int k = 0; k < 500; ++k) text += Flaser(180, k);
  const std::string path = directory_.File("log.gz");
  gzFile file = gzopen(path.c_str(), "wb");
  gzwrite(file, text.data(), static_cast<unsigned>(text.size()));
  gzclose(file);
  auto log = ReadCarmenLog(path, std::nullopt, NoProgress);
  ASSERT_TRUE(log.ok());
  EXPECT_EQ(log->scans.size(), 500u);
  EXPECT_FALSE(log->ends_early);

  std::ifstream in(path, std::ios::binary);
  std::string bytes((std::istreambuf_iterator<char>(in)), {});
  std::ofstream(path, std::ios::binary) << bytes.substr(0, bytes.size() / 2);
  log = ReadCarmenLog(path, std::nullopt, NoProgress);
  ASSERT_TRUE(log.ok());
  EXPECT_TRUE(log->ends_early);
  EXPECT_GT(log->scans.size(), 0u);
}

std::vector<CarmenScan> ScansAt(const std::vector<double>& times_s) {
  std::vector<CarmenScan> scans(times_s.size());
  for (size_t k = 0; k < times_s.size(); ++k) scans[k].time_s = times_s[k];
  return scans;
}

TEST(RepairTimesTest, GoodTimesStay) {
  const RepairedTimes times = RepairTimes(ScansAt({100.25, 100.5, 400}), 10);
  EXPECT_EQ(times.utimes,
            (std::vector<Utime>{Utime(100'250'000), Utime(100'500'000), Utime(400'000'000)}));
  EXPECT_EQ(times.replaced, 0);
}

TEST(RepairTimesTest, TimesThatStandStillGoBackJumpOrAreNoneAreReplaced) {
  const double nan = std::nan("");
  for (const std::vector<double>& bad : {std::vector<double>{0, 0, 0},
                                         {1e9, 1e9, 1e9},
                                         {5, 4, 3},
                                         {5, 5000, 1e5},
                                         {2147483647, -2147483648.0, -2147483647.9},
                                         {nan, nan, nan},
                                         {1e300, 1e300, 1e308},
                                         {7, 7 + 1e-9, 7 + 2e-9}}) {
    const RepairedTimes times = RepairTimes(ScansAt(bad), 20);
    ASSERT_EQ(times.utimes.size(), 3u);
    EXPECT_EQ(times.utimes[1] - times.utimes[0], std::chrono::milliseconds(50)) << bad[0];
    EXPECT_GT(times.utimes[2], times.utimes[1]);
    EXPECT_GE(times.replaced, 1);
  }
}

}  // namespace splinemap::carmen_log_test
