#include "lib/base/did_you_mean.h"

#include <gtest/gtest.h>

namespace splinemap::did_you_mean_test {

TEST(DidYouMeanTest, NamesWhatIsNear) {
  const std::vector<std::string> names = {"yaw_deg", "mask", "x_m", "y_m", "beam_times"};
  EXPECT_EQ(DidYouMean("maks", names), " (did you mean mask?)");
  EXPECT_EQ(DidYouMean("yaw", names), " (did you mean yaw_deg?)");
  EXPECT_EQ(DidYouMean("beam_time", names), " (did you mean beam_times?)");
  EXPECT_EQ(DidYouMean("Y_M", names), " (did you mean y_m?)");
}

TEST(DidYouMeanTest, IsSilentWhereNothingIs) {
  EXPECT_EQ(DidYouMean("nonsense", {"mask", "no_return"}), "");
  EXPECT_EQ(DidYouMean("", {"a"}), "");
  EXPECT_EQ(DidYouMean("ab", {"cd"}), "");
  EXPECT_EQ(DidYouMean("mask", {}), "");
}

}  // namespace splinemap::did_you_mean_test
