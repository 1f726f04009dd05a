#include "services/uplink/pace.h"

#include <gtest/gtest.h>

#include <chrono>

namespace splinemap::pace_test {

using std::chrono::milliseconds;

const Clock::time_point kBegin{std::chrono::hours(1)};

TEST(PaceTest, HalfASecondGoesAtOnceAndThenSoManyBytesASecond) {
  Pace pace(1000);
  EXPECT_EQ(pace.Take(500, kBegin), kBegin);
  EXPECT_EQ(pace.Take(100, kBegin), kBegin + milliseconds(100));
  EXPECT_EQ(pace.Take(900, kBegin), kBegin + milliseconds(1000));
  // What is more than half a second's waits until its rest is due.
  EXPECT_EQ(pace.Take(3000, kBegin + milliseconds(1000)), kBegin + milliseconds(4000));
}

TEST(PaceTest, WhatWasNotUsedIsNotSaved) {
  Pace pace(1000);
  EXPECT_EQ(pace.Take(500, kBegin), kBegin);
  const Clock::time_point later = kBegin + std::chrono::hours(1);
  EXPECT_EQ(pace.Take(500, later), later);
  EXPECT_EQ(pace.Take(500, later), later + milliseconds(500));
}

TEST(PaceTest, TheMeanIsKept) {
  Pace pace(80'000);
  Clock::time_point now = kBegin;
  for (int k = 0; k < 1000; ++k) now = pace.Take(1000, now);
  EXPECT_EQ(now, kBegin + milliseconds(12'500 - 500));
}

}  // namespace splinemap::pace_test
