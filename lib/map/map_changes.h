#pragma once

#include <optional>

#include "lib/map/map_view.h"
#include "lib/tiles/region.h"

namespace splinemap {

// The smallest box over the tiles in which the merged maps may differ, of two views by one
// or follower. Costs what changed; all tiles where a layer is gone, muted, shifted or in a new
// session.
TileBox ChangedTiles(const MapView& before, const MapView& after);

// Where the merged maps may differ, also where knot intervals do; nothing where they are equal.
std::optional<Region> ChangedRegion(const MapView& before, const MapView& after);

}  // namespace splinemap
