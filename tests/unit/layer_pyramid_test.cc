#include "lib/layers/layer_pyramid.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "lib/map/map_changes.h"
#include "lib/map/placed_tile.h"
#include "lib/map/summed_layers.h"
#include "lib/tiles/coarser_tile.h"
#include "splinemap/map_view.h"
#include "splinemap/region.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"

namespace splinemap::layer_pyramid_test {

using Random = std::mt19937_64;

ControlPoint At(const TileTree& tiles, int32_t i, int32_t j) {
  const auto tile = FindTile(tiles, TileOf(i, j));
  return tile == nullptr ? 0 : tile->control_points[IndexInTile(i, j)];
}

bool TilesEqual(const TileTree& a, const TileTree& b) {
  bool are_equal = a.size() == b.size();
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const auto tile = FindTile(b, key);
    are_equal = are_equal && tile != nullptr && *tile == *entry.tile->Get();
  });
  return are_equal;
}

// Tiles about the origin with gaps in them, of both signs.
void Commit(Layer& layer, Random& random, int half_width) {
  layer.BeginCommit();
  for (int n = 0; n < 4; ++n) {
    Tile& tile = layer.EditTile(RandomKey(random, half_width));
    for (int k = 0; k < 300; ++k) {
      tile.control_points[random() % Tile::kSize] =
          static_cast<ControlPoint>(int(random() % 4001) - 2000);
    }
  }
}

TEST(CoarserTileTest, IsWhatItsFormulasSay) {
  Random random(1);
  MapWriter map({0.05, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  for (int n = 0; n < 4; ++n) Commit(layer, random, 2);
  const TileTree& finer = layer.tiles();
  constexpr int kWeights[] = {1, 4, 6, 4, 1};
  int differences = 0;
  for (int32_t ty = -2; ty < 2; ++ty) {
    for (int32_t tx = -2; tx < 2; ++tx) {
      const Tile value = CoarserTile(finer, {tx, ty}, Statistic::kMean);
      const Tile min = CoarserTile(finer, {tx, ty}, Statistic::kMin);
      const Tile max = CoarserTile(finer, {tx, ty}, Statistic::kMax);
      for (int32_t j = 32 * ty; j < 32 * ty + 32; ++j) {
        for (int32_t i = 32 * tx; i < 32 * tx + 32; ++i) {
          int sum = 0;
          bool touched = false;
          for (int l = -2; l <= 2; ++l) {
            for (int k = -2; k <= 2; ++k) {
              const ControlPoint point = At(finer, 2 * i + k, 2 * j + l);
              sum += kWeights[k + 2] * kWeights[l + 2] * point;
              touched |= point != 0;
            }
          }
          int mean = static_cast<int>(std::floor((sum + 128) / 256.0));
          if (touched && mean == 0) mean = 1;
          const auto [least, greatest] =
              std::minmax({At(finer, 2 * i, 2 * j), At(finer, 2 * i + 1, 2 * j),
                           At(finer, 2 * i, 2 * j + 1), At(finer, 2 * i + 1, 2 * j + 1)});
          const bool any = least != 0 || greatest != 0;
          const int at = IndexInTile(i, j);
          differences += value.control_points[at] != mean;
          differences += min.control_points[at] != (any && least == 0 ? -1 : least);
          differences += max.control_points[at] != (any && greatest == 0 ? 1 : greatest);
        }
      }
    }
  }
  EXPECT_EQ(differences, 0);
}

// A straight slope stays one, also across tiles.
TEST(CoarserTileTest, KeepsAStraightSlope) {
  MapWriter map({0.05, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int32_t ty = -4; ty < 4; ++ty) {
    for (int32_t tx = -4; tx < 4; ++tx) {
      Tile& tile = layer.EditTile({tx, ty});
      for (int k = 0; k < Tile::kSize; ++k) {
        tile.control_points[k] =
            static_cast<ControlPoint>(3000 + 4 * (32 * tx + k % 32) - 8 * (32 * ty + k / 32));
      }
    }
  }
  for (const TileKey key : {TileKey{0, 0}, TileKey{-1, -1}, TileKey{-1, 0}}) {
    const Tile tile = CoarserTile(layer.tiles(), key, Statistic::kMean);
    for (int k = 0; k < Tile::kSize; ++k) {
      ASSERT_EQ(tile.control_points[k],
                3000 + 8 * (32 * key.tx + k % 32) - 16 * (32 * key.ty + k / 32));
    }
  }
}

// Made a piece at a time while the layer changes = made at once of the last state.
TEST(LayerPyramidTest, PiecewiseEqualsAtOnce) {
  Random random(2);
  MapWriter map({0.05, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  LayerPyramid piecewise(3);
  EXPECT_FALSE(piecewise.HasLayers());
  for (int n = 0; n < 300; ++n) {
    Commit(layer, random, 1 + n % 30);
    piecewise.Advance(layer.Snapshot(), 1 + random() % 20);
  }
  const LayerSnapshot last = layer.Snapshot();
  for (int n = 0; n < 1000 && (!piecewise.HasLayers() ||
                               piecewise.Layer({1, Statistic::kMean}).revision != last.revision);
       ++n) {
    piecewise.Advance(last, 100);
  }
  EXPECT_FALSE(piecewise.Advance(last, 100));
  LayerPyramid at_once(3);
  ASSERT_TRUE(at_once.Advance(last, 1'000'000));
  for (int level = 1; level <= 3; ++level) {
    for (const Statistic statistic : {Statistic::kMean, Statistic::kMin, Statistic::kMax}) {
      const LayerSnapshot a = piecewise.Layer({level, statistic});
      const LayerSnapshot b = at_once.Layer({level, statistic});
      EXPECT_EQ(a.revision, last.revision);
      EXPECT_GT(b.tiles.size(), 0u);
      EXPECT_TRUE(TilesEqual(a.tiles, b.tiles)) << level << " " << int(statistic);
    }
  }
}

TEST(LayerPyramidTest, BoundsHoldForTheSumOfLayers) {
  Random random(3);
  MapWriter map({0.05, {-2000, 2000}});
  std::vector<LayerSnapshot> fine;
  std::vector<LayerSnapshot> least;
  std::vector<LayerSnapshot> greatest;
  for (const char* name : {"one", "two", "three"}) {
    Layer& layer = map.AddLayer({name, 1}, {1, 1});
    for (int n = 0; n < 20; ++n) Commit(layer, random, 6);
    LayerPyramid levels(3);
    ASSERT_TRUE(levels.Advance(layer.Snapshot(), 1'000'000));
    fine.push_back(layer.Snapshot());
    least.push_back(levels.Layer({3, Statistic::kMin}));
    greatest.push_back(levels.Layer({3, Statistic::kMax}));
  }
  const auto sum_of = [&](const std::vector<LayerSnapshot>& layers) {
    return ViewOf({.options = map.options(), .layers = layers})->tiles;
  };
  const TileTree sum = sum_of(fine);
  const TileTree min = sum_of(least);
  const TileTree max = sum_of(greatest);
  int touched = 0;
  for (int32_t j = -6 * 32; j < 6 * 32; ++j) {
    for (int32_t i = -6 * 32; i < 6 * 32; ++i) {
      const int value = At(sum, i, j);
      if (value == 0) continue;
      ++touched;
      // +1 stands for 0 where something is known.
      ASSERT_LE(At(min, i >> 3, j >> 3), std::max(value, 1));
      ASSERT_GE(At(max, i >> 3, j >> 3), value);
    }
  }
  EXPECT_GT(touched, 10'000);
}

// A layer at a coarser level, placed there = placed, and then the level is made of it, or wider.
TEST(LayerPyramidTest, BoundsHoldForLayersThatArePlaced) {
  Random random(5);
  for (const FixedPose2& placement :
       {ShiftBy(8, -16), ShiftBy(3, 1), PlacedAt(0.02, 0.01, 0), PlacedAt(0, 0, 90),
        PlacedAt(0.13, -1, 180), PlacedAt(1, 2, 33), PlacedAt(-0.7, 0.1, -140)}) {
    MapWriter map({0.05, {}});
    Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
    for (int n = 0; n < 20; ++n) Commit(layer, random, 3);
    const TileTree placed = Placed(layer.Snapshot().tiles, KnotPlacement(placement, 0.05));
    LayerPyramid levels(3);
    ASSERT_TRUE(levels.Advance(layer.Snapshot(), 1'000'000));
    for (int level = 1; level <= 3; ++level) {
      const auto at_level = [&](Statistic statistic) {
        const LevelOfDetail level_of_detail{level, statistic};
        return Placed(levels.Layer(level_of_detail).tiles,
                      KnotPlacement(placement, std::ldexp(0.05, level), level_of_detail));
      };
      const TileTree min = at_level(Statistic::kMin);
      const TileTree max = at_level(Statistic::kMax);
      int touched = 0;
      placed.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        const auto tile = entry.tile->Get();
        for (int k = 0; k < Tile::kSize; ++k) {
          const int value = tile->control_points[k];
          if (value == 0) continue;
          ++touched;
          const int32_t i = (32 * key.tx + k % 32) >> level;
          const int32_t j = (32 * key.ty + k / 32) >> level;
          ASSERT_LE(At(min, i, j), value);
          ASSERT_GE(At(max, i, j), value);
        }
      });
      EXPECT_GT(touched, 5'000);
    }
  }
}

TEST(RegionTest, TilesOfARegionDecideAllOfIt) {
  // Support of the spline: one control point before to two after the knot interval.
  EXPECT_EQ(TilesOf({0, 0, 1.4, 1.6}, 0.05), (TileBox{-1, -1, 1, 2}));
  EXPECT_EQ(TilesOf({0.06, 0.06, 1.4, 1.44}, 0.05), (TileBox{0, 0, 1, 1}));
  const TileBox all = TilesOf({-1e300, -1e300, 1e300, 1e300}, 0.05);
  EXPECT_TRUE(all.Contains({(1 << 23) - 1, -(1 << 23)}));
}

TEST(MapChangesTest, BoxIsThatOfTheTilesThatChanged) {
  MapWriter map({0.05, {}});
  Layer& one = map.AddLayer({"one", 1}, {1, 1});
  one.BeginCommit();
  one.EditTile({9, 9}).control_points[0] = 5;
  const auto before = map.View();
  EXPECT_TRUE(ChangedTiles(*before, *map.View()).IsEmpty());
  one.BeginCommit();
  one.EditTile({-2, 3}).control_points[0] = 5;
  one.EditTile({1, 4}).control_points[0] = 5;
  const auto after = map.View();
  const TileBox box = ChangedTiles(*before, *after);
  EXPECT_EQ(box, (TileBox{-2, 3, 2, 5}));
  // Every point at which the two differ lies in the region.
  const Region region = RegionOf(box, 0.05);
  Random random(4);
  std::uniform_real_distribution<double> coordinate(-5, 12);
  int changed = 0;
  for (int n = 0; n < 200'000; ++n) {
    const double x_m = coordinate(random);
    const double y_m = coordinate(random);
    if (before->Evaluate(x_m, y_m).log_odds == after->Evaluate(x_m, y_m).log_odds) continue;
    ++changed;
    ASSERT_TRUE(x_m >= region.x0_m && x_m <= region.x1_m && y_m >= region.y0_m &&
                y_m <= region.y1_m);
  }
  EXPECT_GT(changed, 0);
  // A layer more: all of it.
  map.AddLayer({"two", 1}, {1, 1});
  EXPECT_EQ(ChangedTiles(*after, *map.View()), (TileBox{-2, 3, 10, 10}));
}

}  // namespace splinemap::layer_pyramid_test
