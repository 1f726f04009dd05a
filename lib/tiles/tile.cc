#include "splinemap/tile.h"

#include <algorithm>

namespace splinemap {

int CountTouched(const Tile& tile) {
  return static_cast<int>(std::count_if(tile.control_points.begin(), tile.control_points.end(),
                                        [](ControlPoint c) { return c != 0; }));
}

}  // namespace splinemap
