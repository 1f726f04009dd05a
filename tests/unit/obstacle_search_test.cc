#include "lib/query/obstacle_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace splinemap::obstacle_search_test {

// Against small steps along the way.
TEST(NearSweepTest, RanksSquaresAndHalfPlanesByTheirFirstTouch) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> coordinate(-3, 3);
  std::uniform_real_distribution<double> size(0.01, 2);
  int touched = 0;
  int left_behind = 0;
  for (int n = 0; n < 150; ++n) {
    const NearSweep sweep{{coordinate(random), coordinate(random)},
                          {coordinate(random), coordinate(random)},
                          n % 3 == 0 ? 0 : size(random)};
    const SearchSquare square{{coordinate(random), coordinate(random)}, size(random)};
    const Eigen::Vector2d normal =
        Eigen::Vector2d(coordinate(random), coordinate(random)).normalized();
    const HalfPlane half{normal, coordinate(random)};
    const Eigen::Vector2d way = sweep.to - sweep.from;
    constexpr double kStep = 1e-3;
    double first_of_square = INFINITY;
    double first_of_half = INFINITY;
    for (double gone = 0; gone < way.norm(); gone += kStep) {
      const Eigen::Vector2d centre = sweep.from + gone / way.norm() * way;
      const bool touches = (square.NearestTo(centre) - centre).norm() <= sweep.radius;
      EXPECT_EQ(sweep.Touches(square, gone), touches);
      if (touches) first_of_square = std::min(first_of_square, gone);
      if (!touches && gone > first_of_square) ++left_behind;
      if (half.normal.dot(centre) + sweep.radius >= half.offset) {
        first_of_half = std::min(first_of_half, gone);
      }
    }
    EXPECT_LE(sweep.Rank(square), first_of_square);
    EXPECT_LE(sweep.Rank(half), first_of_half);
    if (std::isfinite(first_of_square)) {
      ++touched;
      EXPECT_GE(sweep.Rank(square), first_of_square - kStep - 1e-6);
    }
    if (std::isfinite(first_of_half)) {
      EXPECT_GE(sweep.Rank(half), first_of_half - kStep - 1e-6);
    }
  }
  EXPECT_GT(touched, 20);
  EXPECT_GT(left_behind, 50);
}

}  // namespace splinemap::obstacle_search_test
