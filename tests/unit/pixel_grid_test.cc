#include "lib/render/pixel_grid.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/support/map_writer.h"

namespace splinemap::pixel_grid_test {

// Touched from knot (-4, -2) to (10, 6), 0.1 m apart.
std::shared_ptr<const MapView> Room() {
  MapWriter map({0.1, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int j = -2; j <= 6; ++j) {
    for (int i = -4; i <= 10; ++i) {
      layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] = -100;
    }
  }
  return map.View();
}

TEST(PixelGridTest, AtTheKnotIntervalPixelsAreCentredOnTheTouchedControlPoints) {
  const auto grid = GridOfRegion(*Room(), std::nullopt, 0.1);
  ASSERT_TRUE(grid.ok());
  EXPECT_EQ(grid->width, 15);
  EXPECT_EQ(grid->height, 9);
  for (int column = 0; column < 15; ++column) {
    EXPECT_EQ(grid->CentreX(column), (-4 + column) / 10.0);
  }
  for (int row = 0; row < 9; ++row) EXPECT_EQ(grid->CentreY(row), (6 - row) / 10.0);
  EXPECT_EQ(grid->left_m, -0.45);
  EXPECT_EQ(grid->bottom_m(), -0.25);
}

TEST(PixelGridTest, ARegionHasThePixelsWhoseCentresItHas) {
  const auto grid = GridOfRegion(*Room(), Region{-0.3, 0.15, 0.7, 0.2}, 0.05);
  ASSERT_TRUE(grid.ok());
  EXPECT_EQ(grid->width, 20);  // -0.3 is in, 0.7 is not
  EXPECT_EQ(grid->height, 1);
  EXPECT_EQ(grid->CentreX(0), -0.3);
  EXPECT_EQ(grid->CentreX(19), 0.65);
  EXPECT_EQ(grid->CentreY(0), 0.15);
}

TEST(PixelGridTest, RegionsSideBySideShareNoPixelAndMissNone) {
  const auto map = Room();
  for (const double resolution_m : {0.1, 0.05, 0.1 / 3, 0.07, 0.25}) {
    for (int k = -40; k < 40; ++k) {
      const double border_m = k * 0.1;
      const auto left = GridOfRegion(*map, Region{-5, 0, border_m, 1}, resolution_m);
      const auto right = GridOfRegion(*map, Region{border_m, 0, 5, 1}, resolution_m);
      const auto both = GridOfRegion(*map, Region{-5, 0, 5, 1}, resolution_m);
      ASSERT_EQ(left->width + right->width, both->width) << resolution_m << " " << border_m;
      EXPECT_EQ(left->CentreX(0), both->CentreX(0));
      EXPECT_EQ(right->CentreX(0), both->CentreX(left->width));
      EXPECT_EQ(right->CentreX(right->width - 1), both->CentreX(both->width - 1));
    }
  }
}

TEST(PixelGridTest, HostileRegionsAndResolutionsAreRefused) {
  const auto map = Room();
  constexpr double kInf = std::numeric_limits<double>::infinity();
  const Region good{0, 0, 1, 1};
  ASSERT_TRUE(GridOfRegion(*map, good, 0.1).ok());
  for (const Region& region : {Region{0, 0, 0, 1},
                               {1, 0, 0, 1},
                               {0, 1, 1, 0},
                               {NAN, 0, 1, 1},
                               {0, 0, 1, NAN},
                               {0, 0, kInf, 1},
                               {-kInf, 0, 1, 1},
                               {0, 0, 1e300, 1},
                               {0, -1e8, 1, 1},
                               {0.01, 0, 0.09, 1}}) {
    EXPECT_TRUE(absl::IsInvalidArgument(GridOfRegion(*map, region, 0.1).status()))
        << region.x0_m << " " << region.y0_m << " " << region.x1_m << " " << region.y1_m;
  }
  for (const double resolution_m : {0.0, -0.1, 1e-300, 0.1 / 65, 1e300, kInf, double{NAN}}) {
    EXPECT_TRUE(absl::IsInvalidArgument(
        GridOfRegion(*map, Region{0.01, 0.01, 1, 1}, resolution_m).status()))
        << resolution_m;
  }
  // A wide and low region has as many pixels as is allowed, the next one too many.
  constexpr double kLimit_m = (1 << 28) * 0.1;
  EXPECT_EQ(GridOfRegion(*map, Region{-kLimit_m / 2, 0, kLimit_m / 2, 0.1}, 0.1)->width, 1 << 28);
  EXPECT_TRUE(absl::IsInvalidArgument(
      GridOfRegion(*map, Region{-kLimit_m, 0, kLimit_m, 0.1}, 0.1).status()));
}

TEST(PixelGridTest, AnEmptyMapHasPixelsOnlyInARegion) {
  MapWriter map({0.05, {}});
  map.AddLayer({"robot", 1}, {1, 1});
  EXPECT_TRUE(absl::IsFailedPrecondition(GridOfRegion(*map.View(), std::nullopt, 0.05).status()));
  EXPECT_TRUE(GridOfRegion(*map.View(), Region{0, 0, 1, 1}, 0.05).ok());
}

}  // namespace splinemap::pixel_grid_test
