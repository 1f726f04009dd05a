#include "lib/map/placed_tile.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <climits>
#include <cmath>
#include <map>
#include <random>
#include <set>
#include <utility>

#include "lib/map/summed_layers.h"
#include "splinemap/map_view.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"

namespace splinemap::placed_tile_test {

using Random = std::mt19937_64;

constexpr double kKnot_m = 0.05;
constexpr ControlLimits kLimits{-2560, 2560};

ControlPoint At(const TileTree& tiles, int64_t i, int64_t j) {
  const TileKey key{static_cast<int32_t>(i >> 5), static_cast<int32_t>(j >> 5)};
  const auto tile = IsInRange(key) ? FindTile(tiles, key) : nullptr;
  return tile == nullptr ? 0 : tile->control_points[32 * (j & 31) + (i & 31)];
}

// Of nearly everything about the origin, with gaps.
TileTree RandomTiles(Random& random, int extent = 2) {
  TileTreeEditor tiles;
  for (int n = 0; n < 6 * extent * extent; ++n) {
    tiles.Edit(RandomKey(random, extent), 1).Edit() = RandomTile(random, kLimits);
  }
  return tiles.Freeze();
}

// Of the function at each knot (i, j), |i|, |j| < 32 extent.
template <typename Function>
TileTree TilesOf(int32_t extent, Function function) {
  TileTreeEditor tiles;
  for (int32_t j = -32 * extent; j < 32 * extent; ++j) {
    for (int32_t i = -32 * extent; i < 32 * extent; ++i) {
      tiles.Edit(TileOf(i, j), 1).Edit().control_points[IndexInTile(i, j)] =
          static_cast<ControlPoint>(function(i, j));
    }
  }
  return tiles.Freeze();
}

bool AreEqual(const TileTree& a, const TileTree& b) {
  const auto has_all_of = [](const TileTree& one, const TileTree& other) {
    bool has_all = true;
    other.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      const auto tile = FindTile(one, key);
      has_all = has_all && *entry.tile->Get() == (tile == nullptr ? Tile() : *tile);
    });
    return has_all;
  };
  return has_all_of(a, b) && has_all_of(b, a);
}

MapView ViewOfTiles(TileTree tiles) {
  MapView view;
  view.options = {kKnot_m, kLimits};
  view.tiles = std::move(tiles);
  return view;
}

TEST(PlacedTileTest, AShiftByWholeKnotsCopiesEveryControlPoint) {
  Random random(1);
  const TileTree layer = RandomTiles(random);
  for (const auto& [i, j] : {std::pair(0, 0), {1, 0}, {-32, 64}, {7, -40}, {31, 1}, {-1000, 999}}) {
    const KnotPlacement placement(ShiftBy(i, j), kKnot_m);
    EXPECT_TRUE(placement.IsExact());
    EXPECT_EQ(placement.IsIdentity(), i == 0 && j == 0);
    const TileTree placed = Placed(layer, placement);
    for (int32_t y = -100; y < 100; ++y) {
      for (int32_t x = -100; x < 100; ++x) ASSERT_EQ(At(placed, x + i, y + j), At(layer, x, y));
    }
  }
}

// Placements are rounded to 1 um, which must not make a shift another kind of thing.
TEST(PlacedTileTest, ShiftsAreOfWholeKnotsToAThousandth) {
  for (const double knot_m : {0.001, 0.05, 0.07, 1.0 / 3}) {
    for (const double knots : {1.0, -17.0, 123456.0}) {
      EXPECT_FALSE(IsApproximate(ShiftBy(knots, 0, knot_m), knot_m)) << knot_m << " " << knots;
      EXPECT_TRUE(IsApproximate(ShiftBy(knots + 0.01, 0, knot_m), knot_m));
    }
  }
  EXPECT_FALSE(IsApproximate(ShiftBy(3.0009, -0.0009), 0.05));
  EXPECT_TRUE(IsApproximate(ShiftBy(0, 3.0015), 0.05));
  EXPECT_TRUE(IsApproximate(FixedPose2{.yaw = 1}, 0.05));
  EXPECT_FALSE(IsApproximate(PlacedAt(1, 2, 180), 0.05));
  EXPECT_FALSE(IsApproximate(PlacedAt(1, 2, -90), 0.05));
  EXPECT_TRUE(IsApproximate(PlacedAt(1, 2, 45), 0.05));
}

TEST(PlacedTileTest, QuartersOfATurnCopyEveryControlPoint) {
  Random random(2);
  const TileTree layer = RandomTiles(random);
  const TileTree left = Placed(layer, KnotPlacement(PlacedAt(0.5, -1, 90), kKnot_m));
  const TileTree back = Placed(layer, KnotPlacement(PlacedAt(0.5, -1, 180), kKnot_m));
  const TileTree right = Placed(layer, KnotPlacement(PlacedAt(0.5, -1, 270), kKnot_m));
  for (int32_t j = -100; j < 100; ++j) {
    for (int32_t i = -100; i < 100; ++i) {
      ASSERT_EQ(At(left, 10 - j, -20 + i), At(layer, i, j));
      ASSERT_EQ(At(back, 10 - i, -20 - j), At(layer, i, j));
      ASSERT_EQ(At(right, 10 + j, -20 - i), At(layer, i, j));
    }
  }
}

TEST(PlacedTileTest, WhatIsAlikeFromAllSidesStaysAsItIs) {
  const TileTree layer = TilesOf(2, [](int32_t i, int32_t j) {
    return std::abs(i) < 40 && std::abs(j) < 40 ? 1 + std::abs(i * j) : 0;
  });
  EXPECT_TRUE(AreEqual(Placed(layer, KnotPlacement(PlacedAt(0, 0, 90), kKnot_m)), layer));
}

TEST(PlacedTileTest, EveryTileThatATileHasAPartInIsFound) {
  Random random(3);
  std::uniform_real_distribution<double> turn_deg(-180, 180);
  std::uniform_real_distribution<double> place_m(-1e5, 1e5);
  for (int n = 0; n < 300; ++n) {
    const double scale = n % 3 == 0 ? 1 : 1e-4;
    const KnotPlacement placement(PlacedAt(scale * place_m(random), scale * place_m(random),
                                           n % 7 == 0 ? 90 * (n % 4) : turn_deg(random)),
                                  kKnot_m);
    const TileKey key = RandomKey(random, 1000);
    TileTreeEditor tiles;
    tiles.Edit(key, 1).Edit().control_points.fill(1000);
    const TileTree layer = tiles.Freeze();
    const std::vector<TileKey> found = KeysOfPlaced(key, placement);
    EXPECT_LE(found.size(), 9u);
    const std::set<TileKey> keys(found.begin(), found.end());
    EXPECT_EQ(keys.size(), found.size());
    TileBox around;
    int known = 0;
    for (const TileKey of_map : keys) around.Add(of_map);
    for (int32_t ty = around.ty0 - 2; ty < around.ty1 + 2; ++ty) {
      for (int32_t tx = around.tx0 - 2; tx < around.tx1 + 2; ++tx) {
        Tile tile;
        if (!PlaceTile(layer, {tx, ty}, placement, tile)) continue;
        EXPECT_TRUE(keys.contains({tx, ty}));
        known += CountTouched(tile);
      }
    }
    EXPECT_NEAR(known, Tile::kSize, placement.IsExact() ? 0 : 60);
  }
}

TEST(PlacedTileTest, ARegionNeedsNoOtherTiles) {
  Random random(4);
  std::uniform_real_distribution<double> turn_deg(-180, 180);
  std::uniform_real_distribution<double> place_m(-3, 3);
  for (int n = 0; n < 60; ++n) {
    const TileTree layer = RandomTiles(random, 4);
    const FixedPose2 pose = PlacedAt(place_m(random), place_m(random), turn_deg(random));
    const KnotPlacement placement(n % 5 == 0 ? ShiftBy(n - 30, 3 * n) : pose, kKnot_m);
    const double x_m = place_m(random);
    const double y_m = place_m(random);
    const Region region{x_m, y_m, x_m + 0.7, y_m + 0.3};
    const TileBox box = TilesUnder(region, placement, kKnot_m);
    TileTreeEditor part;
    layer.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (box.Contains(key)) part.Put(key, entry.tile, 1);
    });
    const MapView of_all = ViewOfTiles(Placed(layer, placement));
    const MapView of_part = ViewOfTiles(Placed(part.Freeze(), placement));
    for (int k = 0; k < 200; ++k) {
      const double x = x_m + 0.7 * (k % 20) / 19;
      const double y = y_m + 0.3 * (k / 20) / 9;
      ASSERT_EQ(of_all.Evaluate(x, y).log_odds, of_part.Evaluate(x, y).log_odds);
    }
  }
}

// Catmull-Rom's weights of control points at -1, 0, 1, 2 for a place t in [0, 1).
std::array<double, 4> WeightsAt(double t) {
  return {t * (-1 + t * (2 - t)) / 2, 1 + t * t * (3 * t - 5) / 2, t * (1 + t * (4 - 3 * t)) / 2,
          t * t * (t - 1) / 2};
}

TEST(PlacedTileTest, OthersAreInterpolatedAsTheFormulasSay) {
  Random random(8);
  int compared = 0;
  for (int n = 0; n < 20; ++n) {
    const TileTree layer = RandomTiles(random);
    const FixedPose2 pose = PlacedAt(0.01 * n, 0.3, n % 3 == 0 ? 0 : 31 * n);
    const KnotPlacement placement(pose, kKnot_m);
    if (placement.IsExact()) continue;
    const TileTree placed = Placed(layer, placement);
    const Eigen::Rotation2Dd turn(-pose.ToPose().yaw_rad);
    for (int32_t j = -64; j < 64; ++j) {
      for (int32_t i = -64; i < 64; ++i) {
        const Eigen::Vector2d place =
            turn * (Eigen::Vector2d(i, j) - pose.ToPose().position_m / kKnot_m) * 256;
        const Eigen::Vector2d fraction = place - place.array().floor().matrix();
        if ((fraction.array() - 0.5).abs().minCoeff() < 1e-6) continue;  // rounded either way
        const double x = std::round(place.x()) / 256;
        const double y = std::round(place.y()) / 256;
        const auto x0 = static_cast<int32_t>(std::floor(x));
        const auto y0 = static_cast<int32_t>(std::floor(y));
        const int nearest =
            At(layer, std::lround(std::floor(x + 0.5)), std::lround(std::floor(y + 0.5)));
        double expected = nearest;
        int least = nearest;
        int greatest = nearest;
        for (int l = -1; l <= 2; ++l) {
          for (int k = -1; k <= 2; ++k) {
            const int point = At(layer, x0 + k, y0 + l);
            if (point == 0) continue;
            expected += WeightsAt(x - x0)[k + 1] * WeightsAt(y - y0)[l + 1] * (point - nearest);
            if (std::abs(x0 + k - x) >= 1 || std::abs(y0 + l - y) >= 1) continue;
            least = std::min(least, point);
            greatest = std::max(greatest, point);
          }
        }
        if (nearest == 0) {
          ASSERT_EQ(At(placed, i, j), 0);
          continue;
        }
        expected = std::clamp<double>(expected, least, greatest);
        ++compared;
        if (At(placed, i, j) == 1 && std::abs(expected) < 0.51) continue;
        ASSERT_NEAR(At(placed, i, j), expected, 0.501);
      }
    }
  }
  EXPECT_GT(compared, 50'000);
}

TEST(PlacedTileTest, AStraightSlopeStaysOne) {
  const TileTree layer = TilesOf(4, [](int32_t i, int32_t j) { return 9000 + 20 * i - 30 * j; });
  const FixedPose2 pose = PlacedAt(0.333, -0.777, 37);
  const MapView placed = ViewOfTiles(Placed(layer, KnotPlacement(pose, kKnot_m)));
  const Pose2 layer_T_map = Inverse(pose.ToPose());
  for (double y_m = -2; y_m < 2; y_m += 0.03) {
    for (double x_m = -2; x_m < 2; x_m += 0.03) {
      const Eigen::Vector2d knots = (layer_T_map * Eigen::Vector2d(x_m, y_m)) / kKnot_m;
      const double expected = 9000 + 20 * knots.x() - 30 * knots.y();
      // Places are rounded to 1/256 knot interval.
      ASSERT_NEAR(256 * placed.Evaluate(x_m, y_m).log_odds, expected, 0.6);
    }
  }
}

// The face of a wall, where control points go from free to occupied and back behind it.
TEST(PlacedTileTest, AWallStaysWhereItIs) {
  const TileTree layer = TilesOf(4, [](int32_t i, int32_t) {
    const double knots = i - 0.3;
    return std::abs(knots) < 3 ? std::lround(512 * (2 - std::abs(knots)) + 1) : -513;
  });
  const MapView before = ViewOfTiles(layer);
  for (const double turn_deg : {3.0, 30.0, 45.0, 71.0}) {
    const FixedPose2 pose = PlacedAt(0.02, 0.7, turn_deg);
    const MapView placed = ViewOfTiles(Placed(layer, KnotPlacement(pose, kKnot_m)));
    for (double y_m = -2; y_m < 2; y_m += 0.01) {
      const auto face_m = [&](const MapView& map, const Pose2& map_T_layer) {
        double free_m = -0.3;
        double occupied_m = 0;
        while (occupied_m - free_m > 1e-6) {
          const double x_m = (free_m + occupied_m) / 2;
          const Eigen::Vector2d point_m = map_T_layer * Eigen::Vector2d(x_m, y_m);
          (map.Evaluate(point_m.x(), point_m.y()).log_odds > 0 ? occupied_m : free_m) = x_m;
        }
        return occupied_m;
      };
      ASSERT_NEAR(face_m(placed, pose.ToPose()), face_m(before, {}), 0.002) << turn_deg;
    }
  }
}

TEST(PlacedTileTest, NothingSwingsOverAndWhatIsKnownStaysSo) {
  Random random(5);
  for (int n = 0; n < 20; ++n) {
    const TileTree layer = RandomTiles(random, 3);
    const FixedPose2 pose = PlacedAt(0.01 * n, -0.03 * n, 7 + 17 * n);
    const TileTree placed = Placed(layer, KnotPlacement(pose, kKnot_m));
    const Pose2 layer_T_map = Inverse(pose.ToPose());
    int known = 0;
    int differ = 0;
    for (int32_t j = -150; j < 150; ++j) {
      for (int32_t i = -150; i < 150; ++i) {
        const Eigen::Vector2d place =
            (layer_T_map * Eigen::Vector2d(kKnot_m * i, kKnot_m * j)) / kKnot_m;
        const auto x = static_cast<int32_t>(std::floor(place.x()));
        const auto y = static_cast<int32_t>(std::floor(place.y()));
        const ControlPoint point = At(placed, i, j);
        const ControlPoint nearest = At(layer, std::lround(place.x()), std::lround(place.y()));
        known += point != 0;
        differ += (point != 0) != (nearest != 0);
        if (point == 0) continue;
        int least = INT_MAX;
        int greatest = INT_MIN;
        // One further where rounding to 1/256 may have got to it.
        for (int32_t v = y - 1; v <= y + 2; ++v) {
          for (int32_t u = x - 1; u <= x + 2; ++u) {
            if (std::abs(u - place.x()) > 1.01 || std::abs(v - place.y()) > 1.01) continue;
            if (At(layer, u, v) == 0) continue;
            least = std::min<int>(least, At(layer, u, v));
            greatest = std::max<int>(greatest, At(layer, u, v));
          }
        }
        ASSERT_TRUE(point == 1 || (point >= least && point <= greatest));
      }
    }
    EXPECT_GT(known, 1000);
    EXPECT_LT(differ, known / 50);  // places in the middle, which are rounded to 1/256
  }
}

TEST(PlacedTileTest, FarFromTheOriginItIsTheSameAsThere) {
  Random random(6);
  const TileTree layer = RandomTiles(random);
  // 2^24 knots away; there and at the origin alike, to the rounding of places.
  const FixedPose2 near = PlacedAt(0, 0, 90);
  const TileTree there = Placed(layer, KnotPlacement(ShiftBy(1 << 24, -(1 << 24)), kKnot_m));
  const double far_m = kKnot_m * (1 << 24);
  const TileTree back = Placed(there, KnotPlacement(PlacedAt(-far_m, -far_m, 90), kKnot_m));
  EXPECT_TRUE(AreEqual(back, Placed(layer, KnotPlacement(near, kKnot_m))));
}

TEST(PlacedTileTest, WhatIsPlacedBeyondEveryMapIsLeftOut) {
  TileTreeEditor tiles;
  tiles.Edit({0, 0}, 1).Edit().control_points.fill(7);
  const TileTree layer = tiles.Freeze();
  for (const double x_m : {-3e7, 3e7}) {
    for (const double knot_m : {0.001, 0.05, 10'000.0}) {
      for (const double turn_deg : {0.0, 12.0}) {
        const KnotPlacement placement(PlacedAt(x_m, 0.3 * x_m, turn_deg), knot_m);
        const bool is_within = std::abs(x_m) / knot_m < kMaxKnotIndex;
        EXPECT_EQ(KeysOfPlaced({0, 0}, placement).empty(), !is_within);
        EXPECT_EQ(Placed(layer, placement).size() == 0, !is_within);
      }
    }
  }
}

// What every reader has to get: another processor, compiler or library must not change it.
TEST(PlacedTileTest, BytesAreThoseOfEveryReader) {
  Random random(7);
  uint64_t hash = 14695981039346656037u;
  for (int n = 0; n < 40; ++n) {
    // Without distributions, which are others in other libraries.
    const TileTree layer = TilesOf(1, [&](int32_t, int32_t) {
      const auto bits = static_cast<int32_t>(random() >> 40);
      return bits % 3 == 0 ? 0 : bits % 2560;
    });
    const auto pick = [&] { return static_cast<int32_t>(random()); };
    const FixedPose2 pose{pick() >> 8, pick() >> 8, pick()};
    const TileTree placed = Placed(layer, KnotPlacement(pose, kKnot_m));
    for (int32_t j = -300; j < 300; ++j) {
      for (int32_t i = -300; i < 300; ++i) {
        hash = (hash ^ static_cast<uint16_t>(At(placed, i, j))) * 1099511628211u;
      }
    }
  }
  EXPECT_EQ(hash, 1698705304012581129u);
}

}  // namespace splinemap::placed_tile_test
