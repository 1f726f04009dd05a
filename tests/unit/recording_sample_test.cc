#include "lib/diagnosis/recording_sample.h"

#include <gtest/gtest.h>

namespace splinemap::recording_sample_test {

using std::chrono::milliseconds;

RangeReadings ReadingsAt(Utime utime) {
  RangeReadings readings;
  readings.utime = utime;
  readings.ranges_m.assign(100, 1);
  readings.bearings_rad.assign(100, 0);
  return readings;
}

TEST(DriveCollectorTest, KeepsScansOfDifferentPlacesThinned) {
  DriveCollector collector(60, 30);
  for (int n = 0; n < 100; ++n) {
    // Stands still for 5 s and then drives at 0.6 m/s.
    collector.AddPose({milliseconds(100 * n), {{0.06 * std::max(0, n - 50), 0}, 0}});
    collector.AddScan(ReadingsAt(milliseconds(100 * n)), Utime(0));
  }
  // One while it stood, one every 0.12 m until 1.5 s before the end.
  ASSERT_EQ(collector.sample().scans.size(), 18u);
  EXPECT_EQ(collector.sample().scans[0].ranges_m.size(), 25u) << "every fourth of 100 beams";
  EXPECT_EQ(collector.sample().turned_rad, 0);
}

TEST(DriveCollectorTest, StopsWhenItIsFull) {
  DriveCollector collector(5, 30);
  for (int n = 0; n < 1000; ++n) {
    collector.AddPose({milliseconds(100 * n), {{0, 0}, 0.1 * n}});
    collector.AddScan(ReadingsAt(milliseconds(100 * n)), Utime(0));
  }
  EXPECT_TRUE(collector.full());
  EXPECT_EQ(collector.sample().scans.size(), 5u);
  EXPECT_NEAR(collector.sample().turned_rad, 0.4, 1e-9);
}

TEST(DriveCollectorTest, ScansOfAnotherClockAreBroughtToThePoses) {
  DriveCollector collector(5, 30);
  for (int n = 0; n < 100; ++n) {
    collector.AddPose({milliseconds(100 * n), {{0.1 * n, 0}, 0}});
    collector.AddScan(ReadingsAt(std::chrono::hours(1) + milliseconds(100 * n)),
                      -std::chrono::hours(1));
  }
  EXPECT_TRUE(collector.full());
}

TEST(DriveCollectorTest, LatePosesAndScansOfTheFutureCostLittle) {
  DriveCollector collector(5, 30);
  collector.AddScan(ReadingsAt(std::chrono::hours(50)), Utime(0));
  for (int n = 0; n < 200'000; ++n) {
    collector.AddPose({milliseconds(1'000'000 + 10 * n - (n % 3) * 5000), {{0.001 * n, 0}, 0}});
    if (n % 10 == 0) collector.AddScan(ReadingsAt(milliseconds(1'000'000 + 10 * n)), Utime(0));
  }
  EXPECT_TRUE(collector.full());
}

TEST(SampleOfTest, TakesScansOfNewPlacesUpToTheNumber) {
  std::vector<RangeReadings> scans{ReadingsAt(std::chrono::hours(50))};
  PoseBuffer poses(std::chrono::years(300));
  for (int n = 0; n < 200; ++n) {
    poses.Add({milliseconds(100 * n), {{0.05 * n, 0}, 0.1 * n}});
    scans.push_back(ReadingsAt(milliseconds(100 * n)));
  }
  const RecordingSample sample = SampleOf(scans, poses, Utime(0), 50);
  EXPECT_EQ(sample.scans.size(), 50u);
  EXPECT_NEAR(sample.turned_rad, 4.9, 1e-6);
}

TEST(HasPosesAroundTest, WantsAMarginAndNoGap) {
  PoseBuffer poses(std::chrono::hours(1));
  for (int n = 0; n <= 50; ++n) poses.Add({milliseconds(100 * n), {}});
  for (int n = 62; n <= 100; ++n) poses.Add({milliseconds(100 * n), {}});
  EXPECT_FALSE(HasPosesAround(poses, milliseconds(1400)));
  EXPECT_TRUE(HasPosesAround(poses, milliseconds(1500)));
  EXPECT_FALSE(HasPosesAround(poses, milliseconds(5500))) << "in a gap";
  EXPECT_FALSE(HasPosesAround(poses, milliseconds(8600)));
  EXPECT_FALSE(HasPosesAround(PoseBuffer(Utime(0)), Utime(0)));
}

}  // namespace splinemap::recording_sample_test
