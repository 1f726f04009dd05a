#include "lib/tiles/sum_tiles.h"

#include "absl/container/inlined_vector.h"
#include "lib/tiles/sum_kernel.h"

namespace splinemap {

Tile SumTiles(const std::vector<const Tile*>& tiles, ControlLimits limits) {
  static const auto sum = SumKernels().back().sum;
  absl::InlinedVector<const ControlPoint*, 32> control_points;
  for (const Tile* tile : tiles) {
    control_points.push_back(tile == nullptr ? nullptr : tile->control_points.data());
  }
  Tile result;
  sum(control_points.data(), control_points.size(), limits, result.control_points.data());
  return result;
}

}  // namespace splinemap
