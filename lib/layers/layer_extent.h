#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "absl/container/flat_hash_map.h"
#include "splinemap/fixed_pose2.h"
#include "splinemap/region.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The part of the plane that a layer knows: of each control point that a measurement touched, the
// square of the knot interval about it. Thread-compatible.
class LayerExtent {
 public:
  // Adds a tile, or replaces it.
  void Set(TileKey key, const TouchedPoints& touched);
  void SetAll(const TileTree& tiles);

  double area_m2(double knot_interval_m) const;
  // Around all squares, in the map frame; none where nothing is known. Where the layer is turned,
  // around those of a tile, turned, and so some more. Costs all tiles.
  std::optional<Region> Box(const FixedPose2& map_T_layer, double knot_interval_m) const;

 private:
  absl::flat_hash_map<TileKey, TouchedPoints> tiles_;
  int64_t points_ = 0;
};

}  // namespace splinemap
