#include "lib/map/tile_update.h"

#include <xxhash.h>
#include <zstd.h>

#include <array>
#include <bit>
#include <cstring>

#include "lib/base/status.h"

namespace splinemap {
namespace {

static_assert(std::endian::native == std::endian::little,
              "encodings and checksums are defined on little-endian bytes");

constexpr int kZstdLevel = 3;
constexpr size_t kTileBytes = sizeof(Tile::control_points);

// What a neighbour to the left, or in the first column below, suggests for control point k.
int Predict(const std::array<ControlPoint, Tile::kSize>& c, int k) {
  if (k % Tile::kSide != 0) return c[k - 1];
  return k >= Tile::kSide ? c[k - Tile::kSide] : 0;
}

}  // namespace

uint64_t TileChecksum(TileKey key, const Tile& tile) {
  const uint64_t seed =
      (uint64_t{static_cast<uint32_t>(key.ty)} << 32) | static_cast<uint32_t>(key.tx);
  return XXH3_64bits_withSeed(tile.control_points.data(), kTileBytes, seed);
}

std::string EncodeTile(const Tile& tile) {
  std::array<uint8_t, kTileBytes> bytes;
  for (int k = 0; k < Tile::kSize; ++k) {
    const auto residual =
        static_cast<int16_t>(tile.control_points[k] - Predict(tile.control_points, k));
    // Zigzag: small residuals of either sign have a high byte of 0.
    const auto folded = static_cast<uint16_t>((residual << 1) ^ (residual >> 15));
    bytes[k] = static_cast<uint8_t>(folded);
    bytes[Tile::kSize + k] = static_cast<uint8_t>(folded >> 8);
  }
  std::string content(ZSTD_compressBound(bytes.size()), '\0');
  const size_t size =
      ZSTD_compress(content.data(), content.size(), bytes.data(), bytes.size(), kZstdLevel);
  content.resize(size);
  return content;
}

absl::StatusOr<Tile> DecodeTile(const std::string& content) {
  std::array<uint8_t, kTileBytes> bytes;
  const size_t size = ZSTD_decompress(bytes.data(), bytes.size(), content.data(), content.size());
  if (ZSTD_isError(size)) return DataLoss("tile content: {}", ZSTD_getErrorName(size));
  if (size != bytes.size()) {
    return DataLoss("tile content has {} bytes in place of {}", size, bytes.size());
  }
  Tile tile;
  for (int k = 0; k < Tile::kSize; ++k) {
    const int folded = bytes[k] | (bytes[Tile::kSize + k] << 8);
    const int residual = (folded >> 1) ^ -(folded & 1);
    tile.control_points[k] = static_cast<ControlPoint>(Predict(tile.control_points, k) + residual);
  }
  return tile;
}

TileUpdate MakeTileUpdate(TileKey key, const Tile& tile, uint64_t revision) {
  return {key, revision, EncodeTile(tile), TileChecksum(key, tile)};
}

absl::StatusOr<Tile> TileOfUpdate(const TileUpdate& update) {
  SPLINEMAP_ASSIGN_OR_RETURN(Tile tile, DecodeTile(update.content));
  if (TileChecksum(update.key, tile) != update.checksum) {
    return DataLoss("tile ({}, {}) does not match its checksum", update.key.tx, update.key.ty);
  }
  return tile;
}

}  // namespace splinemap
