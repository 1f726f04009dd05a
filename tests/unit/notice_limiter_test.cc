#include "services/splinemapd/notice_limiter.h"

#include <gtest/gtest.h>

#include "lib/base/clock.h"

namespace splinemap::notice_limiter_test {

using std::chrono::seconds;

TEST(NoticeLimiterTest, SaysEachSubjectOnceAMinuteWithTheNumberLeftUnsaid) {
  NoticeLimiter limiter;
  const Clock::time_point start{};
  const Notice late{.subject = "late", .text = "a scan is late"};
  EXPECT_EQ(limiter.Say(late, start), "a scan is late");
  for (int n = 1; n < 60; ++n) EXPECT_EQ(limiter.Say(late, start + seconds(n)), std::nullopt);
  const Notice many{.subject = "many", .text = "many scans", .times = 3};
  EXPECT_EQ(limiter.Say(many, start + seconds(30)), "many scans (2 times more)");
  EXPECT_EQ(limiter.Say(late, start + seconds(60)), "a scan is late (59 times more)");
  EXPECT_EQ(limiter.Say(late, start + seconds(120)), "a scan is late");
}

TEST(NoticeLimiterTest, WhatIsOverIsSaidAtOnceWhenItHappensAgain) {
  NoticeLimiter limiter;
  const Clock::time_point start{};
  const Notice away{.subject = "bus", .text = "the bus is away"};
  EXPECT_EQ(limiter.Say(away, start), "the bus is away");
  limiter.Forget("bus");
  EXPECT_EQ(limiter.Say(away, start + seconds(1)), "the bus is away");
  EXPECT_EQ(limiter.Say(away, start + seconds(2)), std::nullopt);
}

}  // namespace splinemap::notice_limiter_test
