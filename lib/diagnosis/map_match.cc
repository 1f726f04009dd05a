#include "lib/diagnosis/map_match.h"

#include <algorithm>

#include "splinemap/tile.h"

namespace splinemap {
namespace {

constexpr size_t kHitsLookedUp = 30;
constexpr ControlPoint kFree = -1 * kUnitsPerLogOdds;

// Of the control point nearest to a point; 0 where there is none.
ControlPoint NearestControlPoint(const Eigen::Vector2d& point_m, const TileTree& tiles,
                                 double knot_interval_m) {
  const auto x = LocateKnot(point_m.x() + knot_interval_m / 2, knot_interval_m);
  const auto y = LocateKnot(point_m.y() + knot_interval_m / 2, knot_interval_m);
  if (!x || !y) return 0;
  const Tile* tile = tiles.Find(TileOf(x->index, y->index));
  return tile == nullptr ? ControlPoint{0} : tile->control_points[IndexInTile(x->index, y->index)];
}

}  // namespace

HitsInMap FindHits(const PlacedScan& scan, const TileTree& tiles, double knot_interval_m) {
  HitsInMap hits;
  const size_t step = std::max<size_t>(1, scan.beams.size() / kHitsLookedUp);
  for (size_t k = 0; k < scan.beams.size(); k += step) {
    const PlacedBeam& beam = scan.beams[k];
    if (!beam.hit) continue;
    const ControlPoint value = NearestControlPoint(
        beam.origin_world_m + beam.range_m * beam.direction_world, tiles, knot_interval_m);
    ++hits.looked_up;
    if (value < kFree) ++hits.in_free;
  }
  return hits;
}

}  // namespace splinemap
