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

// Of cells along the axes it would lie in one row of them or in two.
TEST(HitEntropyTest, AWallIsAsSharpWhereverItLies) {
  const auto wall_at = [](double y_m) {
    std::vector<Eigen::Vector2d> hits;
    for (int n = 0; n < 5000; ++n) hits.emplace_back(0.001 * n, y_m + 0.002 * (n % 5 - 2));
    return HitEntropy(hits);
  };
  EXPECT_NEAR(wall_at(0.025), wall_at(0), 0.02 * wall_at(0));
}

}  // namespace splinemap::hit_entropy_test
