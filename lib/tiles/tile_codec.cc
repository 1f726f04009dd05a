#include "lib/tiles/tile_codec.h"

#include <xxhash.h>
#include <zstd.h>

#include <bit>
#include <memory>

#include "lib/base/status.h"

namespace splinemap {
namespace {

static_assert(std::endian::native == std::endian::little,
              "encodings and checksums are defined on little-endian bytes");

constexpr int kZstdLevel = 3;
constexpr size_t kTileBytes = sizeof(Tile::control_points);

}  // namespace

uint64_t TileChecksum(TileKey key, const Tile& tile) {
  const uint64_t seed =
      (uint64_t{static_cast<uint32_t>(key.ty)} << 32) | static_cast<uint32_t>(key.tx);
  return XXH3_64bits_withSeed(tile.control_points.data(), kTileBytes, seed);
}

std::string EncodeTile(const Tile& tile) {
  // One for all tiles of a thread: to make one takes as long as a tile.
  thread_local const std::unique_ptr<ZSTD_CCtx, size_t (*)(ZSTD_CCtx*)> context(ZSTD_createCCtx(),
                                                                                &ZSTD_freeCCtx);
  std::string content(ZSTD_compressBound(kTileBytes), '\0');
  content.resize(ZSTD_compressCCtx(context.get(), content.data(), content.size(),
                                   tile.control_points.data(), kTileBytes, kZstdLevel));
  return content;
}

absl::StatusOr<Tile> DecodeTile(const std::string& content) {
  Tile tile;
  const size_t size =
      ZSTD_decompress(tile.control_points.data(), kTileBytes, content.data(), content.size());
  if (ZSTD_isError(size)) return DataLoss("tile content: {}", ZSTD_getErrorName(size));
  if (size != kTileBytes) {
    return DataLoss("tile content has {} bytes in place of {}", size, kTileBytes);
  }
  return tile;
}

TileUpdate MakeTileUpdate(TileKey key, const Tile& tile, uint64_t revision) {
  return {key, revision, EncodeTile(tile), TileChecksum(key, tile)};
}

TileUpdate MakeTileDifference(TileKey key, const Tile& tile, uint64_t revision, const Tile& base) {
  Tile difference;
  for (int k = 0; k < Tile::kSize; ++k) {
    difference.control_points[k] =
        static_cast<ControlPoint>(tile.control_points[k] - base.control_points[k]);
  }
  return {key, revision, EncodeTile(difference), TileChecksum(key, tile), TileChecksum(key, base)};
}

absl::StatusOr<Tile> TileOfUpdate(const TileUpdate& update, const Tile* base) {
  SPLINEMAP_ASSIGN_OR_RETURN(Tile tile, DecodeTile(update.content));
  if (update.base_checksum != 0) {
    if (base == nullptr) return DataLoss("difference to a tile that is not there");
    for (int k = 0; k < Tile::kSize; ++k) {
      tile.control_points[k] =
          static_cast<ControlPoint>(tile.control_points[k] + base->control_points[k]);
    }
  }
  if (TileChecksum(update.key, tile) != update.checksum) {
    return DataLoss("tile ({}, {}) does not match its checksum", update.key.tx, update.key.ty);
  }
  return tile;
}

}  // namespace splinemap
