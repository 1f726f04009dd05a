#include "lib/query/surface_bounds.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <random>

#include "lib/query/cell_patch.h"
#include "tests/support/map_writer.h"

namespace splinemap::surface_bounds_test {

// Of one cell, as the definition says.
struct Cell {
  Bounds bounds;
  bool is_positive = false;
};
Cell CellAt(const TileTree& tiles, int i, int j) {
  CellPatch patch;
  Cell cell;
  for (int k = 0; k < 16; ++k) {
    const int32_t x = i - 1 + k % 4;
    const int32_t y = j - 1 + k / 4;
    const auto tile = FindTile(tiles, TileOf(x, y));
    patch.control_points[k] = tile == nullptr ? 0 : tile->control_points[IndexInTile(x, y)];
    cell.is_positive = cell.is_positive || patch.control_points[k] > 0;
  }
  cell.bounds = patch.bounds();
  return cell;
}

void ExpectBoundsOf(const SurfaceBounds& bounds, const TileTree& tiles) {
  for (int ty = -4; ty < 4; ++ty) {
    for (int tx = -4; tx < 4; ++tx) {
      const std::shared_ptr<const TileBounds> tile = bounds.Find({tx, ty});
      EXPECT_TRUE(tile == nullptr || bounds.box().Contains({tx, ty}));
      Bounds whole{.lower = 1e9, .all_known = true};
      for (int block = 0; block < 16; ++block) {
        Bounds expected{.lower = 1e9, .all_known = true};
        for (int k = 0; k < 64; ++k) {
          const int x = 8 * (block % 4) + k % 8;
          const int y = 8 * (block / 4) + k / 8;
          const Cell cell = CellAt(tiles, Tile::kSide * tx + x, Tile::kSide * ty + y);
          expected.upper = std::max(expected.upper, cell.bounds.upper);
          expected.lower = std::min(expected.lower, cell.bounds.lower);
          expected.all_known = expected.all_known && cell.bounds.all_known;
          if (tile == nullptr) {
            ASSERT_LT(cell.bounds.upper, -1e9) << "a point is known where no bounds are";
            continue;
          }
          ASSERT_EQ(tile->positive[y] >> x & 1, cell.is_positive ? 1U : 0U) << tx << " " << ty;
          ASSERT_EQ(tile->unknown[y] >> x & 1, cell.bounds.all_known ? 0U : 1U);
        }
        if (tile == nullptr) continue;
        // Of the block as a whole more may be untouched than of any cell, and so less sure.
        ASSERT_GE(tile->blocks[block].upper, expected.upper);
        ASSERT_EQ(tile->blocks[block].lower, expected.lower);
        ASSERT_EQ(tile->blocks[block].all_known, expected.all_known);
        ASSERT_TRUE(expected.upper < 0 || tile->blocks[block].upper == expected.upper);
        whole.upper = std::max(whole.upper, tile->blocks[block].upper);
        whole.lower = std::min(whole.lower, expected.lower);
        whole.all_known = whole.all_known && expected.all_known;
      }
      if (tile == nullptr) continue;
      EXPECT_EQ(tile->whole.upper, whole.upper);
      EXPECT_EQ(tile->whole.lower, whole.lower);
      EXPECT_EQ(tile->whole.all_known, whole.all_known);
    }
  }
}

TEST(SurfaceBoundsTest, AreThoseOfTheCellsWhateverWasSeenBefore) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> knot(-70, 70);
  std::uniform_int_distribution<int> value(-900, 300);
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  SurfaceBounds bounds;
  std::vector<std::shared_ptr<const MapView>> views;
  for (int commit = 0; commit < 12; ++commit) {
    layer.BeginCommit();
    // Single points as well as patches that are known, also across the borders of tiles.
    for (int n = 0; n < 3; ++n) {
      const int i0 = n == 1 ? knot(random) & -Tile::kSide : knot(random);
      const int j0 = n == 2 ? knot(random) & -Tile::kSide : knot(random);
      const int side = n == 0 ? 1 : 20;
      for (int j = j0; j < j0 + side; ++j) {
        for (int i = i0; i < i0 + side; ++i) {
          layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
              static_cast<ControlPoint>(value(random));
        }
      }
    }
    views.push_back(map.View());
    // Now and then one of long ago.
    const bool is_old = commit % 4 == 3;
    const auto shown = views[is_old ? views.size() / 2 : views.size() - 1];
    const SurfaceBounds before = bounds;
    bounds.Use(shown);
    ExpectBoundsOf(bounds, shown->tiles);
    ExpectBoundsOf(before, before.map()->tiles);
  }
}

}  // namespace splinemap::surface_bounds_test
