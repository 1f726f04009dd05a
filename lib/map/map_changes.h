#pragma once

#include <optional>

#include "lib/map/map.h"
#include "lib/map/region.h"

namespace splinemap {

// The smallest box over the tiles in which the merged maps may differ, of two snapshots of one Map
// or follower. Costs what changed; all tiles where a layer is gone, muted, shifted or in a new
// epoch.
TileBox ChangedTiles(const MapSnapshot& before, const MapSnapshot& after);

// Where the merged maps may differ, also where knot intervals do; nothing where they are equal.
std::optional<Region> ChangedRegion(const MapSnapshot& before, const MapSnapshot& after);

}  // namespace splinemap
