#pragma once

#include <vector>

#include "splinemap/tile.h"

namespace splinemap {

// The sum of tiles in any order, clamped once at the end; null tiles count as zeros.
Tile SumTiles(const std::vector<const Tile*>& tiles, ControlLimits limits);

}  // namespace splinemap
