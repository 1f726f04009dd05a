#include "lib/diagnosis/hit_entropy.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <numbers>
#include <random>
#include <utility>
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

TEST(HitEntropyTest, IsThatOfCellsCountedOneByOne) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> spread_m(0, 0.3);
  std::vector<Eigen::Vector2d> hits;
  std::map<std::pair<double, double>, int> cells;
  const double turn_rad = 27 * std::numbers::pi / 180;
  for (int n = 0; n < 4000; ++n) {
    hits.emplace_back(spread_m(random), spread_m(random));
    const Eigen::Vector2d turned = Eigen::Rotation2Dd(turn_rad) * hits.back();
    ++cells[{std::floor(turned.x() / 0.05 + 0.5), std::floor(turned.y() / 0.05 + 0.5)}];
  }
  double entropy = 0;
  for (const auto& [cell, count] : cells) entropy -= count / 4000.0 * std::log(count / 4000.0);
  EXPECT_NEAR(HitEntropy(hits), std::exp(entropy), 1e-6);
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
