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
  absl::StatusOr<CarmenLog> Read(const std::string& text) {
    std::ofstream(directory_.File("log"), std::ios::binary) << text;
    return ReadCarmenLog(directory_.File("log"), NoProgress);
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
  EXPECT_TRUE(absl::IsNotFound(ReadCarmenLog(directory_.File("none"), NoProgress).status()));
}

TEST_F(CarmenLogTest, ReadsGzipAndSaysWhenItEndsEarly) {
  std::string text;
  for (int k = 0; k < 500; ++k) text += Flaser(180, k);
  const std::string path = directory_.File("log.gz");
  gzFile file = gzopen(path.c_str(), "wb");
  gzwrite(file, text.data(), static_cast<unsigned>(text.size()));
  gzclose(file);
  auto log = ReadCarmenLog(path, NoProgress);
  ASSERT_TRUE(log.ok());
  EXPECT_EQ(log->scans.size(), 500u);
  EXPECT_FALSE(log->ends_early);

  std::ifstream in(path, std::ios::binary);
  std::string bytes((std::istreambuf_iterator<char>(in)), {});
  std::ofstream(path, std::ios::binary) << bytes.substr(0, bytes.size() / 2);
  log = ReadCarmenLog(path, NoProgress);
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
