#pragma once

#include "splinemap/posed_scan.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// How hits of a scan lie in a map that does not have them yet.
struct HitsInMap {
  int looked_up = 0;
  int in_free = 0;  // control points around it below -1 log-odds: something was seen through there
};

// Looks some 30 hits of the scan up, evenly chosen.
HitsInMap FindHits(const PlacedScan& scan, const TileTree& tiles, double knot_interval_m);

}  // namespace splinemap
