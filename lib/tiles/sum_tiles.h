#pragma once

#include <string>
#include <vector>

#include "splinemap/tile.h"

namespace splinemap {

// The sum of tiles in any order, clamped once at the end; null tiles count as zeros.
Tile SumTiles(const std::vector<const Tile*>& tiles, ControlLimits limits);

// A way of doing that, by the instructions it needs. All of them give the same bytes.
struct TileMerger {
  std::string name;
  void (*merge)(const std::vector<const Tile*>& tiles, ControlLimits limits, Tile& merged);
};

// Those that this processor can run, the fastest first and plain code last.
std::vector<TileMerger> TileMergers();

}  // namespace splinemap
