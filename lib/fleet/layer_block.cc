#include "lib/fleet/layer_block.h"

#include <xxhash.h>

#include <algorithm>
#include <vector>

#include "lib/base/status.h"
#include "lib/fleet/fleet.pb.h"
#include "lib/layers/validity.h"
#include "lib/tiles/tile_codec.h"

namespace splinemap {

bool LayerBlock::IsEmpty() const {
  return std::all_of(tiles.begin(), tiles.end(), [](const Entry& entry) { return !entry.tile; });
}

LayerBlock::Sum LayerBlock::SumOf(BlockKey key) const {
  Sum sum;
  for (int child = 0; child < static_cast<int>(tiles.size()); ++child) {
    if (!tiles[child].tile) continue;
    ++sum.tiles;
    sum.hash += tiles[child].tile->Checksum(key.Tile(child));
  }
  return sum;
}

LayerBlock BlockOf(const TileTree& tiles, BlockKey key) {
  LayerBlock block;
  for (int child = 0; child < static_cast<int>(block.tiles.size()); ++child) {
    const TileKey tile = key.Tile(child);
    if (!IsInRange(tile)) continue;
    block.tiles[child] = {tiles.Share(tile), tiles.RevisionOf(tile)};
  }
  return block;
}

uint64_t HashOf(const LayerBlock& block, BlockKey key) {
  std::vector<uint64_t> content;
  for (int child = 0; child < static_cast<int>(block.tiles.size()); ++child) {
    if (!block.tiles[child].tile) continue;
    content.push_back(static_cast<uint64_t>(child));
    content.push_back(block.tiles[child].tile->Checksum(key.Tile(child)));
  }
  if (content.empty()) return 0;
  return std::max<uint64_t>(XXH3_64bits(content.data(), content.size() * sizeof(uint64_t)), 1);
}

absl::StatusOr<std::string> EncodeBlock(const LayerBlock& block, BlockKey key,
                                        const LayerId* layer) {
  if (block.IsEmpty()) return std::string();
  fleet::BlockRecord record;
  if (layer != nullptr) {
    record.mutable_layer()->set_name(layer->name);
    record.mutable_layer()->set_origin(layer->origin);
  }
  record.set_x(key.x);
  record.set_y(key.y);
  for (int child = 0; child < static_cast<int>(block.tiles.size()); ++child) {
    const LayerBlock::Entry& entry = block.tiles[child];
    if (!entry.tile) continue;
    const std::shared_ptr<const Tile> tile = entry.tile->TryGet();
    const TileKey at = key.Tile(child);
    if (!tile) return DataLoss("tile {},{} cannot be read", at.tx, at.ty);
    fleet::TileRecord& encoded = *record.add_tile();
    encoded.set_child(static_cast<uint32_t>(child));
    encoded.set_revision(entry.revision);
    encoded.set_checksum(entry.tile->Checksum(at));
    encoded.set_content(EncodeTile(*tile));
  }
  return record.SerializeAsString();
}

absl::StatusOr<LayerBlock> DecodeBlock(const std::string& value, BlockKey key, const LayerId* layer,
                                       ControlLimits limits) {
  LayerBlock block;
  if (value.empty()) return block;
  fleet::BlockRecord record;
  if (!record.ParseFromString(value)) return DataLoss("it is no block of tiles");
  const bool is_layers = layer == nullptr ? !record.has_layer()
                                          : record.layer().name() == layer->name &&
                                                record.layer().origin() == layer->origin;
  if (!is_layers || record.x() != key.x || record.y() != key.y) {
    return DataLoss("it is a block of another place");
  }
  for (const fleet::TileRecord& encoded : record.tile()) {
    if (encoded.child() >= block.tiles.size() || block.tiles[encoded.child()].tile) {
      return DataLoss("it has a tile twice, or beside the block");
    }
    const TileKey at = key.Tile(static_cast<int>(encoded.child()));
    TileUpdate update;
    update.key = at;
    update.revision = encoded.revision();
    update.content = encoded.content();
    update.checksum = encoded.checksum();
    SPLINEMAP_ASSIGN_OR_RETURN(const Tile tile, TileOfUpdate(update));
    SPLINEMAP_RETURN_IF_ERROR(CheckTile(at, tile, limits));
    SPLINEMAP_RETURN_IF_ERROR(CheckRevision(update.revision));
    block.tiles[encoded.child()] = {std::make_shared<StoredTile>(tile), update.revision};
  }
  if (block.IsEmpty()) return DataLoss("it is a block without tiles");
  return block;
}

}  // namespace splinemap
