#include "lib/diagnosis/reading_statistics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace splinemap::reading_statistics_test {

// Readings of a room of some metres, 180 beams, `scans` scans, each changed by `change`.
template <typename Change>
ReadingStatistics Room(Change change, int scans = 50, float step_rad = 0.02F) {
  ReadingStatistics statistics;
  std::mt19937_64 random(1);
  std::uniform_real_distribution<float> range(0.5F, 9.F);
  for (int n = 0; n < scans; ++n) {
    RangeReadings readings;
    for (int k = 0; k < 180; ++k) {
      readings.ranges_m.push_back(change(k, range(random)));
      readings.bearings_rad.push_back(step_rad * static_cast<float>(k));
    }
    statistics.Add(readings);
  }
  return statistics;
}

std::string Complaint(const ReadingStatistics& statistics, double range_max_m = 30) {
  const auto complaint = statistics.Complain(range_max_m);
  return complaint ? complaint->text : "";
}

TEST(ReadingStatisticsTest, GoodReadingsAreNotComplainedOf) {
  const float infinity = std::numeric_limits<float>::infinity();
  EXPECT_EQ(Complaint(Room([](int, float r) { return r; })), "");
  EXPECT_EQ(Complaint(Room([&](int k, float r) { return k < 90 ? infinity : r; })), "");
  EXPECT_EQ(Complaint(Room([](int k, float r) { return k < 90 ? 0.F : r; })), "");
  // Sensors have several values for no return.
  EXPECT_EQ(Complaint(Room([](int k, float r) {
              return k < 30 ? 81.83F : k < 60 ? 81.87F : k < 90 ? 81.91F : r;
            })),
            "");
  EXPECT_EQ(Complaint(Room([](int, float r) { return 1000 * r; }, 5)), "") << "too few to tell";
}

TEST(ReadingStatisticsTest, OtherUnitsAreNamed) {
  EXPECT_NE(Complaint(Room([](int, float r) { return 1000 * r; })).find("millimetres"),
            std::string::npos);
  EXPECT_NE(Complaint(Room([](int, float r) { return r; }, 50, 1)).find("degrees"),
            std::string::npos);
  EXPECT_NE(Complaint(Room([](int, float r) { return r; }, 50, 0)).find("radstep is 0"),
            std::string::npos);
  EXPECT_NE(Complaint(Room([](int, float) { return std::nanf(""); })).find("none of its readings"),
            std::string::npos);
}

TEST(ReadingStatisticsTest, AHallIsWiderThanTheDefault) {
  const auto complaint = Room([](int, float r) { return 6 * r; }).Complain(30);
  ASSERT_TRUE(complaint);
  EXPECT_NE(complaint->text.find("lie beyond range_max_m (30 m)"), std::string::npos);
  EXPECT_NEAR(*complaint->right_range_max_m, 54 * 1.05, 1.5);
  EXPECT_FALSE(Room([](int, float r) { return 6 * r; }).Complain(*complaint->right_range_max_m));
}

TEST(ReadingStatisticsTest, ReadingsAtOneRangeBelowTheLimitAreNoReturns) {
  for (const float value_m : {9.5F, 12.F, 29.995F}) {
    const auto complaint = Room([&](int k, float r) { return k < 20 ? value_m : r; }).Complain(30);
    ASSERT_TRUE(complaint) << value_m;
    EXPECT_LT(*complaint->right_range_max_m, value_m);
    EXPECT_GT(*complaint->right_range_max_m, value_m - 0.05);
    // As the limit is set then, all is well.
    const auto mended = Room([&](int k, float r) {
                          return k < 20 ? value_m : r;
                        }).Complain(*complaint->right_range_max_m);
    EXPECT_FALSE(mended) << mended->text;
  }
}

TEST(ReadingStatisticsTest, AnyNumbersAreTaken) {
  ReadingStatistics statistics;
  const float extremes[] = {std::nanf(""),
                            std::numeric_limits<float>::infinity(),
                            -std::numeric_limits<float>::infinity(),
                            std::numeric_limits<float>::max(),
                            std::numeric_limits<float>::lowest(),
                            std::numeric_limits<float>::denorm_min(),
                            0};
  for (int n = 0; n < 100; ++n) {
    RangeReadings readings;
    for (const float value : extremes) {
      readings.ranges_m.push_back(value);
      readings.bearings_rad.push_back(value);
    }
    statistics.Add(readings);
  }
  statistics.Add(RangeReadings{});
  Complaint(statistics);
}

}  // namespace splinemap::reading_statistics_test
