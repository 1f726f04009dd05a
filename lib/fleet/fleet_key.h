#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "splinemap/layer.h"
#include "splinemap/region.h"
#include "splinemap/tile.h"

namespace splinemap {

// A square of 4 x 4 tiles: what one key of a fleet's bucket holds of a layer. A key for each tile
// would cost the engine as much memory as the tile, and one for more tiles the link too much for
// each that changes.
struct BlockKey {
  static constexpr int kSide = 4;

  int32_t x = 0;
  int32_t y = 0;
  auto operator<=>(const BlockKey&) const = default;

  static BlockKey Of(TileKey key) { return {key.tx >> 2, key.ty >> 2}; }
  // Of x + 4 y.
  TileKey Tile(int child) const { return {4 * x + (child & 3), 4 * y + (child >> 2)}; }
  static int ChildOf(TileKey key) { return (key.tx & 3) + 4 * (key.ty & 3); }
  // Whether its tiles have keys that trees take, or nearly.
  bool IsInRange() const {
    constexpr int32_t kMax = kMaxKnotIndex >> 7;
    return x >= -kMax - 1 && x <= kMax && y >= -kMax - 1 && y <= kMax;
  }
  TileBox Tiles() const { return {4 * x, 4 * y, 4 * x + kSide, 4 * y + kSide}; }
};

// The squares of 32 x 32 tiles, 51 m at 5 cm, are dealt out to so many parts. A worker owns whole
// parts, and keys name theirs, so that it can subscribe to them alone.
inline constexpr int kParts = 64;
inline constexpr int kSquareSide = 32;
int PartOf(BlockKey block);
inline int PartOf(TileKey key) { return PartOf(BlockKey::Of(key)); }

// A name as a token of a key: letters, digits, `_` and `-` as they are, other bytes as `=` and two
// hexadecimal digits. NameOfToken() is empty for what is no such token.
std::string TokenOf(std::string_view name);
std::string NameOfToken(std::string_view token);

// The keys of a bucket.
//   map                                         MapRecord
//   settings.NAME.ORIGIN                        store.SettingsRecord
//   layers.NAME.ORIGIN.digest                   DigestRecord
//   layers.NAME.ORIGIN.tiles.PART.X.Y           BlockRecord
// ORIGIN has 16 hexadecimal digits, PART two decimal ones.
inline constexpr const char* kMapKey = "map";
std::string SettingsKey(const LayerId& id);
std::string DigestKey(const LayerId& id);
std::string BlockKeyOf(const LayerId& id, BlockKey block);
// All keys of a layer, those of its tiles, and those of the tiles of a part in all layers.
std::string LayerFilter(const LayerId& id);
std::string DigestFilter(const std::string& name);  // of a robot's layers
std::string TilesFilter(const LayerId& id);
std::string PartFilter(int part);

// Whether a key is one of those of a filter.
bool MatchesFilter(std::string_view filter, std::string_view key);

// What a key names.
struct FleetKey {
  enum class Kind { kMap, kSettings, kDigest, kBlock, kOther };

  Kind kind = Kind::kOther;
  LayerId layer{};   // of all but the map
  BlockKey block{};  // of a block
};
// kOther for what is no such key, and for a block in a part that is not its own.
FleetKey ParseFleetKey(std::string_view key);

}  // namespace splinemap
