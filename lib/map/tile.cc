#include "lib/map/tile.h"

#include <algorithm>
#include <cmath>

namespace splinemap {

std::optional<KnotPosition> LocateKnot(double coordinate_m, double knot_interval_m) {
  const double position = coordinate_m / knot_interval_m;
  if (!(std::abs(position) < kMaxKnotIndex)) return std::nullopt;
  const double index = std::floor(position);
  return KnotPosition{static_cast<int32_t>(index), position - index};
}

int CountTouched(const Tile& tile) {
  return static_cast<int>(std::count_if(tile.control_points.begin(), tile.control_points.end(),
                                        [](ControlPoint c) { return c != 0; }));
}

}  // namespace splinemap
