#include "splinemap/tile.h"

#include <algorithm>

namespace splinemap {

TouchedPoints TouchedPointsOf(const Tile& tile) {
  TouchedPoints touched{.i0 = Tile::kSide, .j0 = Tile::kSide, .i1 = -1, .j1 = -1};
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
  return touched.points == 0 ? TouchedPoints() : touched;
}

}  // namespace splinemap
