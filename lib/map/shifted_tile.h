#pragma once

#include <vector>

#include "splinemap/layer_settings.h"
#include "splinemap/tile.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The tiles of the map, up to four, into which the shift brings control points of a layer's tile;
// those that cannot be are left out.
std::vector<TileKey> KeysOfShifted(TileKey key, KnotShift shift);

// What the layer has in the map's tile `key`: `tile`, which is all zeros before, or null where that
// is nothing.
const Tile* ShiftTile(const TileTree& layer, TileKey key, KnotShift shift, Tile& tile);

}  // namespace splinemap
