#include "services/splinemapd/silence_watch.h"

#include <gtest/gtest.h>

#include "lib/base/clock.h"

namespace splinemap::silence_watch_test {

using Change = SilenceWatch::Change;
using std::chrono::seconds;

TEST(SilenceWatchTest, TellsWhenAChannelFallsSilentAndWhenItIsHeardAgain) {
  const Clock::time_point start{};
  SilenceWatch watch(start);
  EXPECT_EQ(watch.Check(0, start + seconds(4)), Change::kNone);
  EXPECT_EQ(watch.Check(0, start + seconds(5)), Change::kSilent);
  EXPECT_EQ(watch.Check(0, start + seconds(6)), Change::kNone) << "once";
  EXPECT_EQ(watch.Check(3, start + seconds(7)), Change::kHeardAgain);
  EXPECT_EQ(watch.Check(4, start + seconds(11)), Change::kNone);
  EXPECT_EQ(watch.Check(4, start + seconds(15)), Change::kNone);
  EXPECT_EQ(watch.Check(4, start + seconds(16)), Change::kSilent);
}

}  // namespace splinemap::silence_watch_test
