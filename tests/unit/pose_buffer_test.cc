#include "lib/sensing/pose_buffer.h"

#include <gtest/gtest.h>

namespace splinemap::pose_buffer_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

TimedPose At(Utime utime, double x_m) { return {utime, {{x_m, 0}, 0}}; }

TEST(PoseBufferTest, InterpolatesBetweenNeighbours) {
  PoseBuffer poses(seconds(10));
  poses.Add(At(seconds(1), 1));
  poses.Add(At(seconds(3), 5));
  const auto bracket = poses.Find(milliseconds(1500));
  ASSERT_TRUE(bracket);
  EXPECT_NEAR(Interpolate(*bracket, milliseconds(1500)).position_m.x(), 2, 1e-12);
}

TEST(PoseBufferTest, AnExactTimeNeedsNoNeighbour) {
  PoseBuffer poses(seconds(10));
  poses.Add(At(seconds(1), 1));
  const auto bracket = poses.Find(seconds(1));
  ASSERT_TRUE(bracket);
  EXPECT_EQ(bracket->before, bracket->after);
  EXPECT_EQ(Interpolate(*bracket, seconds(1)).position_m.x(), 1);
}

TEST(PoseBufferTest, NothingOutsideItsTimes) {
  PoseBuffer poses(seconds(10));
  EXPECT_FALSE(poses.Find(seconds(1)));
  poses.Add(At(seconds(1), 1));
  poses.Add(At(seconds(2), 1));
  EXPECT_FALSE(poses.Find(milliseconds(999)));
  EXPECT_FALSE(poses.Find(milliseconds(2001)));
}

TEST(PoseBufferTest, OrdersWhatComesOutOfOrder) {
  PoseBuffer poses(seconds(10));
  for (const int s : {5, 3, 4, 1, 2}) EXPECT_TRUE(poses.Add(At(seconds(s), s)));
  for (int ms = 1000; ms <= 5000; ms += 125) {
    const auto bracket = poses.Find(milliseconds(ms));
    ASSERT_TRUE(bracket);
    EXPECT_NEAR(Interpolate(*bracket, milliseconds(ms)).position_m.x(), ms / 1000.0, 1e-12);
  }
}

TEST(PoseBufferTest, TheFirstOfTwoPosesOfOneTimeStays) {
  PoseBuffer poses(seconds(10));
  EXPECT_TRUE(poses.Add(At(seconds(1), 1)));
  EXPECT_FALSE(poses.Add(At(seconds(1), 2)));
  EXPECT_EQ(Interpolate(*poses.Find(seconds(1)), seconds(1)).position_m.x(), 1);
}

TEST(PoseBufferTest, ForgetsWhatIsOlderThanItsHistory) {
  PoseBuffer poses(seconds(10));
  for (int s = 0; s <= 100; ++s) poses.Add(At(seconds(s), s));
  EXPECT_EQ(poses.oldest(), seconds(90));
  EXPECT_FALSE(poses.Add(At(seconds(50), 0)));
}

TEST(PoseBufferTest, IsBoundedAgainstAFlood) {
  PoseBuffer poses(seconds(1000));
  constexpr auto kCount = static_cast<int64_t>(PoseBuffer::kMaxPoses) + 100;
  for (int64_t k = 0; k < kCount; ++k) poses.Add(At(Utime(k), 0));
  EXPECT_EQ(poses.oldest(), Utime(100));
}

}  // namespace splinemap::pose_buffer_test
