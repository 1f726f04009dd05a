#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "splinemap/tile.h"

namespace splinemap {

// A rectangle of the map frame, x0 <= x1 and y0 <= y1.
struct Region {
  double x0_m = 0;
  double y0_m = 0;
  double x1_m = 0;
  double y1_m = 0;

  bool operator==(const Region&) const = default;
};

// Tiles [tx0, tx1) x [ty0, ty1).
struct TileBox {
  int32_t tx0 = 0;
  int32_t ty0 = 0;
  int32_t tx1 = 0;
  int32_t ty1 = 0;

  bool operator==(const TileBox&) const = default;
  bool IsEmpty() const { return tx0 >= tx1 || ty0 >= ty1; }
  bool Contains(TileKey key) const {
    return key.tx >= tx0 && key.tx < tx1 && key.ty >= ty0 && key.ty < ty1;
  }
  void Add(TileKey key) {
    *this = IsEmpty() ? TileBox{key.tx, key.ty, key.tx + 1, key.ty + 1}
                      : TileBox{std::min(tx0, key.tx), std::min(ty0, key.ty),
                                std::max(tx1, key.tx + 1), std::max(ty1, key.ty + 1)};
  }
};

// Control points [i0, i1] x [j0, j1].
struct KnotRange {
  int64_t i0 = 0;
  int64_t j0 = 0;
  int64_t i1 = 0;
  int64_t j1 = 0;
};

// The control points that decide what the surface is in `region`, its border included, as far as
// control points can be.
inline KnotRange KnotsOf(const Region& region, double knot_interval_m) {
  // Of the knot interval that holds a point, control points one before to two after (equation 3).
  const auto knot = [&](double coordinate_m, int reach) {
    constexpr double kMax = kMaxKnotIndex;
    const double index = std::floor(coordinate_m / knot_interval_m) + reach;
    return static_cast<int64_t>(index > -kMax ? std::min(index, kMax) : -kMax);
  };
  return {knot(region.x0_m, -1), knot(region.y0_m, -1), knot(region.x1_m, 2), knot(region.y1_m, 2)};
}

// Those that have one of the control points, as far as tiles can be.
inline TileBox TilesOf(const KnotRange& knots) {
  const auto tile = [](int64_t knot) {
    constexpr int64_t kMax = kMaxKnotIndex;
    return static_cast<int32_t>(std::clamp(knot, -kMax, kMax)) >> 5;
  };
  return {tile(knots.i0), tile(knots.j0), tile(knots.i1) + 1, tile(knots.j1) + 1};
}

// The tiles that decide what the surface is in `region`.
inline TileBox TilesOf(const Region& region, double knot_interval_m) {
  return TilesOf(KnotsOf(region, knot_interval_m));
}

// Where the surface depends on one of the tiles.
inline Region RegionOf(const TileBox& tiles, double knot_interval_m) {
  const double side_m = Tile::kSide * knot_interval_m;
  const double reach_m = 2 * knot_interval_m;
  if (tiles.IsEmpty()) return {};
  return {tiles.tx0 * side_m - reach_m, tiles.ty0 * side_m - reach_m,
          (tiles.tx1 - 1) * side_m + 31 * knot_interval_m + reach_m,
          (tiles.ty1 - 1) * side_m + 31 * knot_interval_m + reach_m};
}

}  // namespace splinemap
