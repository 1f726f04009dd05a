#include "lib/layers/layer_extent.h"

#include <gtest/gtest.h>

#include "tests/support/placement.h"

namespace splinemap::layer_extent_test {

TouchedPoints TouchedAt(std::initializer_list<std::pair<int, int>> points) {
  Tile tile;
  for (const auto& [i, j] : points) tile.control_points[IndexInTile(i, j)] = -7;
  return TouchedPointsOf(tile);
}

TEST(LayerExtentTest, IsOfTheSquaresAboutKnownControlPoints) {
  LayerExtent extent;
  EXPECT_FALSE(extent.Box({}, 0.1));
  extent.Set({0, 0}, TouchedAt({{3, 4}, {3, 5}, {10, 4}}));
  extent.Set({-1, 2}, TouchedAt({{31, 0}}));
  EXPECT_NEAR(extent.area_m2(0.1), 4 * 0.01, 1e-12);
  const auto box = extent.Box({}, 0.1);
  ASSERT_TRUE(box);
  EXPECT_NEAR(box->x0_m, -0.15, 1e-12);
  EXPECT_NEAR(box->y0_m, 0.35, 1e-12);
  EXPECT_NEAR(box->x1_m, 1.05, 1e-12);
  EXPECT_NEAR(box->y1_m, 6.45, 1e-12);
  EXPECT_NEAR(extent.Box(PlacedAt(10, -2, 0), 0.1)->x0_m, 9.85, 1e-12);
  EXPECT_NEAR(extent.Box(PlacedAt(10, -2, 0), 0.1)->y1_m, 4.45, 1e-12);
  const auto turned = extent.Box(PlacedAt(10, -2, 90), 0.1);
  EXPECT_NEAR(turned->x0_m, 10 - 6.45, 1e-12);
  EXPECT_NEAR(turned->y0_m, -2 - 0.15, 1e-12);
  EXPECT_NEAR(turned->x1_m, 10 - 0.35, 1e-12);
  EXPECT_NEAR(turned->y1_m, -2 + 1.05, 1e-12);
}

TEST(LayerExtentTest, ATileThatChangesCountsOnce) {
  LayerExtent extent;
  extent.Set({0, 0}, TouchedAt({{3, 4}, {3, 5}}));
  extent.Set({5, 5}, TouchedAt({}));
  extent.Set({0, 0}, TouchedAt({{3, 4}}));
  EXPECT_NEAR(extent.area_m2(1), 1, 1e-12);
  EXPECT_EQ(extent.Box({}, 1), (Region{2.5, 3.5, 3.5, 4.5}));
  extent.Set({0, 0}, TouchedPointsOf(Tile()));
  EXPECT_FALSE(extent.Box({}, 1));
}

}  // namespace splinemap::layer_extent_test
