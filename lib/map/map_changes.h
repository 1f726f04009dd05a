#pragma once

#include <optional>

#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

// The smallest box over the tiles in which two maps may differ. Costs what changed between two
// views by one SummedLayers; all tiles where a layer is gone, muted, placed anew or in a new
// session.
TileBox ChangedTiles(const MapView& before, const MapView& after);

// Where the merged maps may differ, also where knot intervals do; nothing where they are equal.
std::optional<Region> ChangedRegion(const MapView& before, const MapView& after);

}  // namespace splinemap
