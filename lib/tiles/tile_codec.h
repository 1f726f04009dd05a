#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "splinemap/tile.h"

namespace splinemap {

// One change of one tile of one layer: what is stored, published and sent. Applying one twice, late
// or out of order is harmless, since the greater revision of a key wins.
struct TileUpdate {
  TileKey key;
  uint64_t revision = 0;  // of the layer, in the commit that made this content
  // EncodeTile of the whole tile; or, where base_checksum is not 0, of its difference, point by
  // point and modulo 2^16, to the tile of that TileChecksum.
  std::string content;
  uint64_t checksum = 0;  // TileChecksum of the tile that results
  uint64_t base_checksum = 0;
};

TileUpdate MakeTileUpdate(TileKey key, const Tile& tile, uint64_t revision);
TileUpdate MakeTileDifference(TileKey key, const Tile& tile, uint64_t revision, const Tile& base);

// The tile that the update leaves; `base` is the tile of its base_checksum, where that is not 0.
// DataLoss where the content cannot be decoded or does not match the checksum. Allocates no more
// than a tile, whatever the content claims.
absl::StatusOr<Tile> TileOfUpdate(const TileUpdate& update, const Tile* base = nullptr);

// XXH3 (64 bits) over key and control points, little-endian.
uint64_t TileChecksum(TileKey key, const Tile& tile);

// zstd of the control points, row-major, little-endian. Predicting each from its neighbours first
// gains 14 % on some maps and loses 5 % on others.
std::string EncodeTile(const Tile& tile);
absl::StatusOr<Tile> DecodeTile(const std::string& content);

}  // namespace splinemap
