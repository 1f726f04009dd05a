#include "lib/diagnosis/hit_entropy.h"

#include <gtest/gtest.h>

#include <vector>

namespace splinemap::hit_entropy_test {

TEST(HitEntropyTest, IsTheNumberOfCellsOfEqualShares) {
  EXPECT_EQ(HitEntropy({}), 0);
  std::vector<Eigen::Vector2d> hits;
  for (int n = 0; n < 40; ++n) hits.emplace_back(-1 + 0.05 * (n % 8), 3);
  EXPECT_NEAR(HitEntropy(hits), 8, 1e-9);
}

TEST(HitEntropyTest, AStrayHitAmongManyWeighsLittle) {
  std::vector<Eigen::Vector2d> hits(1000, {0, 0});
  hits.emplace_back(5, 5);
  EXPECT_GT(HitEntropy(hits), 1);
  EXPECT_LT(HitEntropy(hits), 1.01);
}

}  // namespace splinemap::hit_entropy_test
