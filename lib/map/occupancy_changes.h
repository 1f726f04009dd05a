#pragma once

#include <compare>
#include <cstdint>
#include <vector>

#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

struct Knot {
  int32_t i = 0;
  int32_t j = 0;
  auto operator<=>(const Knot&) const = default;
};

// Where something came or went: control points near each other.
struct OccupancyChange {
  bool is_occupied = false;  // now; it was free. Or it was occupied and is free now
  Region region;             // around its control points
  std::vector<Knot> knots;   // its control points
};

// What became occupied or free between two states of a map: obstacles of one, by 1 log-odds, of
// which the other saw free space alone within two knots, so that no wall that was seen from
// elsewhere is a change. The largest first; those of fewer than three control points are left out.
// Costs the tiles that differ.
std::vector<OccupancyChange> OccupancyChanges(const MapView& before, const MapView& now);

}  // namespace splinemap
