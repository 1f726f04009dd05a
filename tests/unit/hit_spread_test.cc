#include "lib/diagnosis/hit_spread.h"

#include <gtest/gtest.h>

#include <vector>

namespace splinemap::hit_spread_test {

TEST(HitSpreadTest, IsTheNumberOfCellsOfEqualShares) {
  EXPECT_EQ(HitSpread({}), 0);
  std::vector<Eigen::Vector2d> hits;
  for (int n = 0; n < 40; ++n) hits.emplace_back(-1 + 0.05 * (n % 8), 3);
  EXPECT_NEAR(HitSpread(hits), 8, 1e-9);
}

TEST(HitSpreadTest, AStrayHitAmongManyWeighsLittle) {
  std::vector<Eigen::Vector2d> hits(1000, {0, 0});
  hits.emplace_back(5, 5);
  EXPECT_GT(HitSpread(hits), 1);
  EXPECT_LT(HitSpread(hits), 1.01);
}

}  // namespace splinemap::hit_spread_test
