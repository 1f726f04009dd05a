#pragma once

#include <optional>

#include "lib/query/cell_patch.h"
#include "lib/query/surface_bounds.h"
#include "splinemap/map_view.h"
#include "splinemap/queries.h"

namespace splinemap {

// Follows rays over the surface: within a knot cell it is a polynomial of degree 6 along the ray,
// whose first crossing of the threshold is found to 1e-6 knot intervals. Squares without anything,
// by their bounds, are taken in one step. Thread-compatible; outlived by what it was made of.
class RayCaster {
 public:
  RayCaster(const SurfaceBounds& bounds, double occupied_log_odds, UnknownPolicy unknown);

  // Requires a ray that Check() lets pass.
  RaysQuery::End Cast(const Ray& ray);

 private:
  // Lengths are in knot intervals from here on.
  struct Line {
    Eigen::Vector2d origin;
    Eigen::Vector2d direction;  // of length 1
    Eigen::Vector2d At(double range) const { return origin + range * direction; }
  };
  // Cells [i, i + side) x [j, j + side).
  struct Square {
    int32_t i;
    int32_t j;
    int32_t side;
  };
  struct End {
    Occupancy occupancy;
    double range;
  };

  End Follow(const Line& line, double begin, double end);
  Square LargestClearSquare(int32_t i, int32_t j);
  std::optional<End> FollowOverCell(const Line& line, const Square& cell, double begin, double end);

  const double knot_interval_m_;
  const double threshold_;  // in units of control points
  const UnknownPolicy unknown_;
  BoundsReader bounds_;
  PatchReader patches_;

  TileKey tile_key_;
  const TileBounds* tile_;  // of that key, null where it is absent
};

}  // namespace splinemap
