#include "lib/archive/scan_record.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "tests/support/recorded_drive.h"
#include "tests/support/shared_data.h"

namespace splinemap::scan_record_test {

constexpr double kDegree = std::numbers::pi / 180;

absl::Span<const uint8_t> BytesOf(const std::string& record) {
  return {reinterpret_cast<const uint8_t*>(record.data()), record.size()};
}

bool SameBits(float a, float b) { return std::bit_cast<uint32_t>(a) == std::bit_cast<uint32_t>(b); }

void ExpectSameBits(const PosedScan& a, const PosedScan& b) {
  EXPECT_EQ(a.channel, b.channel);
  EXPECT_EQ(a.robot_T_sensor, b.robot_T_sensor);
  ASSERT_EQ(a.beams.size(), b.beams.size());
  for (size_t k = 0; k < a.beams.size(); ++k) {
    const Beam& x = a.beams[k];
    const Beam& y = b.beams[k];
    ASSERT_TRUE(SameBits(x.range_m, y.range_m) && SameBits(x.bearing_rad, y.bearing_rad) &&
                x.hit == y.hit && x.reading == y.reading && x.time_offset == y.time_offset)
        << "beam " << k << ": " << x.range_m << " " << x.bearing_rad << " " << x.reading;
  }
}

void ExpectGivenBack(const PosedScan& scan, const BeamModelOptions& model = {}) {
  const auto unpacked = UnpackBeams(BytesOf(PackBeams(scan, model)));
  ASSERT_TRUE(unpacked.ok()) << unpacked.status();
  ExpectSameBits(unpacked->scan, scan);
  EXPECT_EQ(unpacked->model, model);
}

class RandomScanner {
 public:
  explicit RandomScanner(uint64_t seed) : random_(seed) {}

  int Below(int limit) { return std::uniform_int_distribution<int>(0, limit - 1)(random_); }
  double Uniform() { return std::uniform_real_distribution<double>(0, 1)(random_); }

  // Of any kind: each property is one of those that scanners have, or none has.
  PosedScan Scan() {
    PosedScan scan;
    scan.channel = Below(3) == 0 ? Below(1024) : 0;
    scan.beams.resize(Below(4) == 0 ? Below(4) : Below(400));
    SetReadings(scan.beams);
    SetBearings(scan.beams);
    SetRanges(scan.beams);
    const double hit_share = Below(2) == 0 ? 1 : Uniform();
    for (Beam& beam : scan.beams) beam.hit = Uniform() < hit_share;
    SetSensorPoses(scan);
    return scan;
  }

  BeamModelOptions Model() {
    if (Below(3) != 0) return {};
    return {static_cast<BeamUpdate>(Below(3)), 4 * Uniform(), -Uniform(), 1 + Uniform()};
  }

 private:
  void SetReadings(std::vector<Beam>& beams) {
    const int kind = Below(4);
    auto next = static_cast<uint16_t>(kind == 0 ? Below(65'536) : 0);
    for (Beam& beam : beams) {
      if (kind == 1 && Below(20) == 0) next = static_cast<uint16_t>(next + Below(50));
      beam.reading = kind == 2 ? static_cast<uint16_t>(Below(65'536)) : next++;
    }
  }

  void SetBearings(std::vector<Beam>& beams) {
    const int kind = Below(6);
    const double sign = Below(2) == 0 ? -1 : 1;
    const auto first = static_cast<float>(-4 * Uniform());
    const auto step = static_cast<float>(0.02 * Uniform());
    double turned_deg = 0;
    for (Beam& beam : beams) {
      turned_deg += 1 + (kind == 1 ? Below(9) / 64.0 : 0.001 * Below(99));
      const auto degree = static_cast<float>(kDegree);
      const float in_64ths = static_cast<float>(turned_deg) * degree;
      const float choices[] = {static_cast<float>(double{first} + beam.reading * double{step}),
                               in_64ths,
                               static_cast<float>(turned_deg * kDegree),
                               static_cast<float>(-2 + beam.reading * (0.5 * kDegree)),
                               static_cast<float>(7 * Uniform()),
                               AnyFloat()};
      beam.bearing_rad = static_cast<float>(sign) * choices[kind];
    }
  }

  float AnyFloat() {
    for (;;) {
      const auto number = std::bit_cast<float>(static_cast<uint32_t>(random_()));
      if (std::isfinite(number)) return number;
    }
  }

  void SetRanges(std::vector<Beam>& beams) {
    constexpr int kUnits_um[] = {10'000, 1'000, 250, 1};
    const int unit_um = kUnits_um[Below(4)];
    const bool is_noise = Below(4) == 0;
    double range_m = 5;
    for (Beam& beam : beams) {
      range_m = is_noise || Below(30) == 0
                    ? 1000 * Uniform()
                    : std::clamp(range_m + 0.1 * (Uniform() - 0.5), 0.0, 1000.0);
      beam.range_m = static_cast<float>(std::round(range_m * 1e6 / unit_um) * unit_um * 1e-6);
    }
  }

  void SetSensorPoses(PosedScan& scan) {
    const int kind = Below(4);
    const double yaw_rad = 7 * Uniform();
    const double turn_rad = Below(3) == 0 ? 0 : 1e-6 * (Uniform() - 0.5);
    FixedPose2 pose = FixedPose2::Nearest({{Uniform(), Uniform()}, yaw_rad});
    if (kind < 2) {
      scan.robot_T_sensor = {pose};
      return;
    }
    double time_us = 0;
    for (size_t k = 0; k < scan.beams.size(); ++k) {
      time_us += 72 + Below(2);
      pose = FixedPose2::Nearest({{1e-6 * time_us, 0.2}, yaw_rad + turn_rad * time_us});
      if (kind == 3) {
        const auto any = [&] {
          return static_cast<int64_t>(random_() >> 18) - FixedPose2::kMaxUnits;
        };
        pose = {any(), any(), static_cast<int32_t>(random_())};
      }
      scan.robot_T_sensor.push_back(pose);
    }
  }

  std::mt19937_64 random_;
};

TEST(ScanRecordTest, GivesBackEveryBitOfScansOfAllKinds) {
  RandomScanner scanner(1);
  for (int round = 0; round < 2000 && !testing::Test::HasFailure(); ++round) {
    SCOPED_TRACE(round);
    ExpectGivenBack(scanner.Scan(), scanner.Model());
  }
}

TEST(ScanRecordTest, GivesBackExtremes) {
  using Float = std::numeric_limits<float>;
  ExpectGivenBack({});
  PosedScan scan;
  scan.channel = 1023;
  scan.robot_T_sensor = {{FixedPose2::kMaxUnits, -FixedPose2::kMaxUnits, -0x7fffffff - 1}};
  scan.beams = {{0, Float::max(), {}, true, 65'535},
                {1000, Float::lowest(), {}, false, 0},
                {-0.0F, -0.0F, {}, true, 0},
                {Float::denorm_min(), 0, {}, true, 1},
                {Float::min(), Float::min(), {}, true, 7},
                {999.99F, -Float::min(), {}, false, 6}};
  ExpectGivenBack(scan);
  scan.robot_T_sensor.clear();
  for (size_t k = 0; k < scan.beams.size(); ++k) {
    const int64_t far = k % 2 == 0 ? FixedPose2::kMaxUnits : -FixedPose2::kMaxUnits;
    scan.robot_T_sensor.push_back({far, -far, static_cast<int32_t>(k % 3)});
  }
  const BeamModelOptions model{BeamUpdate::kPaperLine, kMaxKappaHit, kMinKappaFree, 1000};
  ExpectGivenBack(scan, model);
  scan.beams.assign(kMaxBeams, scan.beams[1]);
  scan.robot_T_sensor.resize(1);
  ExpectGivenBack(scan);
}

// Cut off or with bytes behind, a record is no record; with other bits it is none, or one of
// something that can be.
TEST(ScanRecordTest, DamagedBytesAreRefusedOrGiveScansThatCanBe) {
  RandomScanner scanner(2);
  for (int round = 0; round < 60; ++round) {
    const std::string record = PackBeams(scanner.Scan(), scanner.Model());
    for (size_t size = 0; size < record.size(); size += 1 + record.size() / 50) {
      EXPECT_FALSE(UnpackBeams(BytesOf(record.substr(0, size))).ok());
    }
    EXPECT_TRUE(absl::IsDataLoss(UnpackBeams(BytesOf(record + '\0')).status()));
    for (int flip = 0; flip < 60; ++flip) {
      std::string damaged = record;
      damaged[scanner.Below(static_cast<int>(record.size()))] ^=
          static_cast<char>(1 << scanner.Below(8));
      const auto unpacked = UnpackBeams(BytesOf(damaged));
      if (!unpacked.ok()) continue;
      EXPECT_LE(unpacked->scan.beams.size(), 8 * damaged.size());
      for (const FixedPose2& pose : unpacked->scan.robot_T_sensor) EXPECT_TRUE(pose.IsValid());
      for (const Beam& beam : unpacked->scan.beams) {
        EXPECT_TRUE(beam.range_m >= 0 && beam.range_m <= 1000);
        EXPECT_TRUE(std::isfinite(beam.bearing_rad));
      }
      ExpectGivenBack(unpacked->scan, unpacked->model);
    }
  }
}

TEST(ScanRecordTest, NoiseIsRefused) {
  std::mt19937_64 random(3);
  for (int round = 0; round < 20'000; ++round) {
    std::vector<uint8_t> noise(random() % 200);
    for (uint8_t& byte : noise) byte = static_cast<uint8_t>(random());
    const auto unpacked = UnpackBeams(noise);
    EXPECT_TRUE(!unpacked.ok() || unpacked->scan.beams.size() <= 8 * noise.size());
  }
}

TEST(ScanRecordTest, WhatCannotBeIsRefused) {
  const auto is_refused = [](const PosedScan& scan, const BeamModelOptions& model = {}) {
    return absl::IsDataLoss(UnpackBeams(BytesOf(PackBeams(scan, model))).status());
  };
  PosedScan scan;
  scan.robot_T_sensor = {{}};
  scan.beams.resize(3);
  EXPECT_FALSE(is_refused(scan));
  for (const float range_m : {-1.0F, 1000.1F, std::numeric_limits<float>::quiet_NaN()}) {
    scan.beams[1].range_m = range_m;
    EXPECT_TRUE(is_refused(scan)) << range_m;
  }
  scan.beams[1] = {};
  scan.beams[2].bearing_rad = std::numeric_limits<float>::infinity();
  EXPECT_TRUE(is_refused(scan));
  scan.beams[2] = {};
  scan.robot_T_sensor[0].x = FixedPose2::kMaxUnits + 1;
  EXPECT_TRUE(is_refused(scan));
  scan.robot_T_sensor[0] = {};
  scan.channel = 1024;
  EXPECT_TRUE(is_refused(scan));
  scan.channel = 0;
  EXPECT_TRUE(is_refused(scan, {.kappa_hit = kMaxKappaHit + 1}));
  EXPECT_TRUE(is_refused(scan, {.kappa_free = std::nan("")}));
}

struct Drive {
  const char* file;
  double step_rad;
  double most_bytes;  // of a scan, in the mean
};

// Bearings as messages say them: first and step are floats.
PosedScan Posed(const Scan& scan, double step_rad) {
  PosedScan posed{0, {}, {}, {FixedPose2::Nearest(scan.robot_T_sensor)}, scan.beams};
  for (Beam& beam : posed.beams) {
    beam.bearing_rad = static_cast<float>(double{static_cast<float>(-90 * kDegree)} +
                                          beam.reading * double{static_cast<float>(step_rad)});
  }
  return posed;
}

TEST(ScanRecordTest, RecordedScansAreSmall) {
  const Drive drives[] = {{"carmen/intel-corrected.log.gz", kDegree, 128},
                          {"carmen/freiburg-079-corrected.log.gz", kDegree / 2, 224}};
  for (const Drive& drive : drives) {
    const auto path = SharedData(drive.file);
    if (!path) GTEST_SKIP() << "the shared data folder is not there";
    const auto scans = ReadRecordedDrive(*path, {});
    ASSERT_TRUE(scans.ok()) << scans.status();
    double bytes = 0;
    for (const RecordedScan& recorded : *scans) {
      const PosedScan scan = Posed(recorded.scan, drive.step_rad);
      const std::string record = PackBeams(scan, {});
      bytes += static_cast<double>(record.size());
      const auto unpacked = UnpackBeams(BytesOf(record));
      ASSERT_TRUE(unpacked.ok()) << unpacked.status();
      ExpectSameBits(unpacked->scan, scan);
    }
    EXPECT_LT(bytes / static_cast<double>(scans->size()), drive.most_bytes) << drive.file;
  }
}

}  // namespace splinemap::scan_record_test
