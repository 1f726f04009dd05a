#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "lib/fleet/fleet_key.h"
#include "lib/fleet/layer_block.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The keys of the bucket that the sum of all layers is published in.
//   sum.PART.X.Y                                BlockRecord of no layer
std::string SumKey(BlockKey block);
std::string SumFilter(int part);
// Nothing for what is no such key.
std::optional<BlockKey> ParseSumKey(std::string_view key);

// Of a sum: its tiles have no revisions.
LayerBlock SumBlockOf(const TileTree& tiles, BlockKey key);

}  // namespace splinemap
