#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "splinemap/fixed_pose2.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/region.h"
#include "splinemap/tile.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// How the control points of a layer lie among those of the map that it is placed in. It decides
// bytes, and is made of additions, multiplications and divisions that all processors do alike.
// Immutable.
//
// Where knots lie on knots, which is so after shifts by whole knot intervals and quarters of a
// turn, control points are copied. Else each one of the map is interpolated between the 4 x 4
// around its place in the layer, by cubic convolution (Catmull-Rom), and kept within those next to
// it: so walls stay where they are and nothing swings over beside them (README.md). Minima and
// maxima of a coarser level are those of all squares that a square of the map touches, and go on
// bounding what they stand for.
class KnotPlacement {
 public:
  // What lies so near to whole knot intervals is on them: placements are rounded to 1 um.
  static constexpr double kRounding = 1e-3;

  // Of the layer at that level of detail, of which the knot interval is.
  KnotPlacement(const FixedPose2& map_T_layer, double knot_interval_m,
                LevelOfDetail level_of_detail = {});

  bool operator==(const KnotPlacement&) const = default;

  // Whether the map has the control points of the layer as they are.
  bool IsIdentity() const;
  // Whether control points are copied. Else the layer is approximate.
  bool IsExact() const { return is_exact_; }

  // The control points of the layer that decide those of the map.
  KnotRange ToLayer(const KnotRange& map) const;

 private:
  friend std::vector<TileKey> KeysOfPlaced(TileKey key, const KnotPlacement& placement);
  friend bool PlaceTile(const TileTree& layer, TileKey key, const KnotPlacement& placement,
                        Tile& tile);

  // A place in the layer, in knot intervals.
  struct Place {
    double x;
    double y;
  };
  bool IsShift() const;  // by whole knot intervals
  Place PlaceOf(int64_t i, int64_t j) const;
  KnotRange SquaresUnder(const Place& place) const;
  KnotRange ToMap(const KnotRange& layer) const;

  double cosine_;
  double sine_;
  double x_knots_;
  double y_knots_;
  Statistic statistic_;
  double finer_;  // the knot interval of level 0, in those of this one
  bool is_exact_;
};

// Whether a layer that is placed so is resampled.
inline bool IsApproximate(const FixedPose2& map_T_layer, double knot_interval_m) {
  return !KnotPlacement(map_T_layer, knot_interval_m).IsExact();
}

// The tiles of the map that a tile of the layer has a part in; those beyond kMaxKnotIndex are left
// out.
std::vector<TileKey> KeysOfPlaced(TileKey key, const KnotPlacement& placement);

// Makes a tile of the map, which has to be all zeros: a control point is known where the nearest
// one of the layer is. False where none is.
bool PlaceTile(const TileTree& layer, TileKey key, const KnotPlacement& placement, Tile& tile);

// The tiles of the layer that one of the map is made of.
std::vector<TileKey> KeysUnder(TileKey key, const KnotPlacement& placement);

// All of a layer, in the map.
TileTree Placed(const TileTree& layer, const KnotPlacement& placement);

// The tiles of a layer that decide what the surface of the map is in `region`.
TileBox TilesUnder(const Region& region, const KnotPlacement& placement, double knot_interval_m);

}  // namespace splinemap
