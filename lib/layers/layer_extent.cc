#include "lib/layers/layer_extent.h"

#include <algorithm>

namespace splinemap {

LayerExtent::Touched LayerExtent::TouchedOf(const Tile& tile) {
  Touched touched{.i0 = Tile::kSide, .j0 = Tile::kSide, .i1 = -1, .j1 = -1};
  for (int k = 0; k < Tile::kSize; ++k) {
    if (tile.control_points[k] == 0) continue;
    const auto i = static_cast<int8_t>(k % Tile::kSide);
    const auto j = static_cast<int8_t>(k / Tile::kSide);
    ++touched.points;
    touched.i0 = std::min(touched.i0, i);
    touched.j0 = std::min(touched.j0, j);
    touched.i1 = std::max(touched.i1, i);
    touched.j1 = std::max(touched.j1, j);
  }
  return touched;
}

void LayerExtent::Set(TileKey key, const Tile& tile) {
  Touched& touched = tiles_[key];
  points_ -= touched.points;
  touched = TouchedOf(tile);
  points_ += touched.points;
}

void LayerExtent::SetAll(const TileTree& tiles) {
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) { Set(key, *entry.tile); });
}

double LayerExtent::area_m2(double knot_interval_m) const {
  return static_cast<double>(points_) * knot_interval_m * knot_interval_m;
}

std::optional<Region> LayerExtent::Box(KnotShift shift, double knot_interval_m) const {
  if (points_ == 0) return std::nullopt;
  int64_t i0 = INT64_MAX;
  int64_t j0 = INT64_MAX;
  int64_t i1 = INT64_MIN;
  int64_t j1 = INT64_MIN;
  for (const auto& [key, touched] : tiles_) {
    if (touched.points == 0) continue;
    const int64_t i = int64_t{Tile::kSide} * key.tx + shift.i;
    const int64_t j = int64_t{Tile::kSide} * key.ty + shift.j;
    i0 = std::min(i0, i + touched.i0);
    j0 = std::min(j0, j + touched.j0);
    i1 = std::max(i1, i + touched.i1);
    j1 = std::max(j1, j + touched.j1);
  }
  const auto edge_m = [&](int64_t knot, double half) {
    return (static_cast<double>(knot) + half) * knot_interval_m;
  };
  return Region{edge_m(i0, -0.5), edge_m(j0, -0.5), edge_m(i1, 0.5), edge_m(j1, 0.5)};
}

}  // namespace splinemap
