#include "lib/map/occupancy_changes.h"

#include <gtest/gtest.h>

namespace splinemap::occupancy_changes_test {

// Free but for obstacles in [i0, i1) x [j0, j1).
MapView Room(const std::vector<std::array<int, 4>>& obstacles) {
  TileTreeEditor tiles;
  for (int ty = 0; ty < 2; ++ty) {
    for (int tx = 0; tx < 2; ++tx) tiles.Edit({tx, ty}, 1).Edit().control_points.fill(-2000);
  }
  for (const auto& [i0, i1, j0, j1] : obstacles) {
    for (int j = j0; j < j1; ++j) {
      for (int i = i0; i < i1; ++i) {
        tiles.Edit(TileOf(i, j), 1).Edit().control_points[IndexInTile(i, j)] = 1500;
      }
    }
  }
  MapView view;
  view.options.knot_interval_m = 0.1;
  view.tiles = tiles.Freeze();
  return view;
}

TEST(OccupancyChangesTest, AChairThatWasMovedIsTwoChanges) {
  const auto changes = OccupancyChanges(Room({{5, 8, 5, 8}}), Room({{30, 34, 40, 44}}));
  ASSERT_EQ(changes.size(), 2u);
  EXPECT_TRUE(changes[0].is_occupied) << "the larger first";
  EXPECT_EQ(changes[0].knots.size(), 16u);
  EXPECT_NEAR(changes[0].region.x0_m, 2.95, 1e-9);
  EXPECT_NEAR(changes[0].region.y1_m, 4.35, 1e-9);
  EXPECT_FALSE(changes[1].is_occupied);
  EXPECT_EQ(changes[1].knots.size(), 9u);
}

TEST(OccupancyChangesTest, AWallThatIsSeenFromElsewhereIsNone) {
  EXPECT_TRUE(OccupancyChanges(Room({{10, 11, 0, 64}}), Room({{11, 13, 0, 64}})).empty());
  EXPECT_FALSE(OccupancyChanges(Room({{10, 11, 0, 64}}), Room({{13, 14, 0, 64}})).empty());
}

TEST(OccupancyChangesTest, WhatWasUnknownIsNoChangeAndNeitherAreSpecks) {
  const MapView nothing{{0.1, {}}, 0, {}};
  EXPECT_TRUE(OccupancyChanges(nothing, Room({{5, 8, 5, 8}})).empty());
  EXPECT_TRUE(OccupancyChanges(Room({}), Room({{5, 7, 5, 6}})).empty());
  EXPECT_EQ(OccupancyChanges(Room({}), Room({{5, 7, 5, 7}})).size(), 1u);
}

}  // namespace splinemap::occupancy_changes_test
