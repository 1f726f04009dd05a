#include "lib/diagnosis/map_match.h"

#include <algorithm>

#include "lib/map/control_point_reader.h"
#include "splinemap/tile.h"

namespace splinemap {
namespace {

constexpr size_t kHitsLookedUp = 30;
constexpr int kLeastKnown = 5;  // of nine
constexpr ControlPoint kFree = -1 * kUnitsPerLogOdds;

// Whether what is known of the control point nearest to a point and of those around it is free.
bool IsFreeAround(const Eigen::Vector2d& point_m, ControlPointReader& map, double knot_interval_m) {
  const auto x = LocateKnot(point_m.x() + knot_interval_m / 2, knot_interval_m);
  const auto y = LocateKnot(point_m.y() + knot_interval_m / 2, knot_interval_m);
  if (!x || !y) return false;
  int known = 0;
  for (int32_t j = y->index - 1; j <= y->index + 1; ++j) {
    for (int32_t i = x->index - 1; i <= x->index + 1; ++i) {
      const int c = map.At(i, j);
      if (c == 0) continue;
      if (c >= kFree) return false;
      ++known;
    }
  }
  return known >= kLeastKnown;
}

}  // namespace

HitsInMap FindHits(const PlacedScan& scan, const TileTree& tiles, double knot_interval_m) {
  HitsInMap hits;
  ControlPointReader map(tiles);
  const size_t step = std::max<size_t>(1, scan.beams.size() / kHitsLookedUp);
  for (size_t k = 0; k < scan.beams.size(); k += step) {
    const PlacedBeam& beam = scan.beams[k];
    if (!beam.hit) continue;
    ++hits.looked_up;
    if (IsFreeAround(beam.origin_world_m + beam.range_m * beam.direction_world, map,
                     knot_interval_m)) {
      ++hits.in_free;
    }
  }
  return hits;
}

}  // namespace splinemap
