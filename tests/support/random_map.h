#pragma once

#include <random>

#include "splinemap/tile.h"

namespace splinemap {

// A tile like those of a real map: mostly untouched or smooth, within `limits`, touched somewhere.
Tile RandomTile(std::mt19937_64& random, ControlLimits limits = {});

// A key near the origin, so that keys repeat.
TileKey RandomKey(std::mt19937_64& random, int extent);

}  // namespace splinemap
