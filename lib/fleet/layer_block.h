#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_key.h"
#include "splinemap/layer_set.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// Tiles of a block, null where there is none.
struct LayerBlock {
  struct Entry {
    std::shared_ptr<const StoredTile> tile;
    uint64_t revision = 0;
  };
  std::array<Entry, BlockKey::kSide * BlockKey::kSide> tiles;

  bool IsEmpty() const;
  // How many there are, and the sum of their checksums.
  struct Sum {
    uint64_t tiles = 0;
    uint64_t hash = 0;
    bool operator==(const Sum&) const = default;
  };
  Sum SumOf(BlockKey key) const;
};

LayerBlock BlockOf(const TileTree& tiles, BlockKey key);

// What a block says: its tiles and their checksums, not their revisions. 0 for one without tiles.
uint64_t HashOf(const LayerBlock& block, BlockKey key);

// A BlockRecord; empty for a block without tiles. No layer: of the sum. DataLoss where a tile
// cannot be read from where it is stored.
absl::StatusOr<std::string> EncodeBlock(const LayerBlock& block, BlockKey key,
                                        const LayerId* layer);
// DataLoss where the value is damaged, or is another layer's or another block's; InvalidArgument
// for tiles that cannot be. Allocates no more than the tiles of a block.
absl::StatusOr<LayerBlock> DecodeBlock(const std::string& value, BlockKey key, const LayerId* layer,
                                       ControlLimits limits);

}  // namespace splinemap
