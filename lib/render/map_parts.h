#pragma once

#include <cstddef>
#include <vector>

#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

// Tiles that lie together: from all others they are 8 tiles or more away.
struct MapPart {
  TileBox box;
  size_t tiles = 0;
};

// The parts of a map, the one with most tiles first.
std::vector<MapPart> PartsOf(const MapView& map);
// Around all of them.
TileBox BoxOf(const std::vector<MapPart>& parts);

}  // namespace splinemap
