#pragma once

#include <random>

#include "splinemap/posed_scan.h"
#include "splinemap/tile.h"

namespace splinemap {

// A tile like those of a real map: mostly untouched or smooth, within `limits`, touched somewhere.
Tile RandomTile(std::mt19937_64& random, ControlLimits limits = {});

// A small scan of a robot within `half_width_m` of the origin: beams that hit and some that do not,
// now and then of a robot that moves meanwhile.
PosedScan RandomScan(std::mt19937_64& random, double half_width_m);

// A key near the origin, so that keys repeat.
TileKey RandomKey(std::mt19937_64& random, int extent);

}  // namespace splinemap
