#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "splinemap/key_tree.h"
#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

// Knot cell (i, j) is the square [i, i + 1] x [j, j + 1] of knot intervals; the surface there is
// decided by control points i - 1 .. i + 2, j - 1 .. j + 2, and lies between the least and the
// greatest of them (equation 4). What bounds it over some cells, in units of control points:
struct Bounds {
  // No point that is known has more. -infinity where none is.
  float upper = -std::numeric_limits<float>::infinity();
  float lower = 0;  // no point has less
  bool all_known = false;
};

// The nearest control point of a point has at least (23/48)^2 of the weight. So where all that was
// touched is below 0, points that are known are below 0 by more than this share of it, though
// untouched control points, which are 0, take part.
inline constexpr float kLeastShareOfNearest = 0.22F;

// The bounds of cells whose control points are between `least` and `greatest`, the latter of those
// that were touched; INT16_MIN where none was.
inline Bounds BoundsOf(int greatest_touched, int least, bool all_touched, bool all_known) {
  Bounds bounds{.lower = static_cast<float>(least), .all_known = all_known};
  if (greatest_touched == std::numeric_limits<ControlPoint>::min()) return bounds;
  const auto greatest = static_cast<float>(greatest_touched);
  bounds.upper = all_touched || greatest > 0 ? greatest : kLeastShareOfNearest * greatest;
  return bounds;
}

// Of the cells of a tile, [32 tx, 32 tx + 32) x [32 ty, 32 ty + 32), and of each block of 8 x 8.
struct TileBounds {
  static constexpr int kBlockSide = 8;
  static constexpr int kBlocks = Tile::kSide / kBlockSide;  // each way

  Bounds whole;
  std::array<Bounds, kBlocks * kBlocks> blocks;  // x runs fastest
  // By row of cells, a bit for each: where points that are known may have more than 0, and where
  // not all points are known.
  std::array<uint32_t, Tile::kSide> positive{};
  std::array<uint32_t, Tile::kSide> unknown{};
};

// The bounds of a map. Tiles that are absent have no known point. Immutable.
struct SurfaceBounds {
  KeyTree<TileBounds> tiles;
  TileBox box;  // around all of them
};

// Follows a map. Thread-compatible.
class SurfaceBoundsEditor {
 public:
  // Costs what changed since the last call, where that was an earlier view by the same
  // SummedLayers.
  SurfaceBounds Update(const MapView& map);

 private:
  uint64_t lineage_ = 0;  // of the tiles seen last
  uint64_t version_ = 0;
  TileBox box_;
  KeyTreeEditor<TileBounds> tiles_;
};

}  // namespace splinemap
