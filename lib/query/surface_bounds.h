#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>

#include "splinemap/map_view.h"
#include "splinemap/region.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// Knot cell (i, j) is the square [i, i + 1] x [j, j + 1] of knot intervals; the surface there is
// decided by control points i - 1 .. i + 2, j - 1 .. j + 2, and lies between the least and the
// greatest of them (equation 4). What bounds it over some cells, in units of control points:
struct Bounds {
  // No point that is known has more. -infinity where none is.
  float upper = -std::numeric_limits<float>::infinity();
  float lower = 0;  // no point has less
  bool all_known = false;
};

// The nearest control point of a point has at least (23/48)^2 of the weight. So where all that was
// touched is below 0, points that are known are below 0 by more than this share of it, though
// untouched control points, which are 0, take part.
inline constexpr float kLeastShareOfNearest = 0.22F;

// The bounds of cells whose control points are between `least` and `greatest`, the latter of those
// that were touched; INT16_MIN where none was.
inline Bounds BoundsOf(int greatest_touched, int least, bool all_touched, bool all_known) {
  Bounds bounds{.lower = static_cast<float>(least), .all_known = all_known};
  if (greatest_touched == std::numeric_limits<ControlPoint>::min()) return bounds;
  const auto greatest = static_cast<float>(greatest_touched);
  bounds.upper = all_touched || greatest > 0 ? greatest : kLeastShareOfNearest * greatest;
  return bounds;
}

// Of the cells of a tile, [32 tx, 32 tx + 32) x [32 ty, 32 ty + 32), and of each block of 8 x 8.
struct TileBounds {
  static constexpr int kBlockSide = 8;
  static constexpr int kBlocks = Tile::kSide / kBlockSide;  // each way

  Bounds whole;
  std::array<Bounds, kBlocks * kBlocks> blocks;  // x runs fastest
  // By row of cells, a bit for each: where points that are known may have more than 0, and where
  // not all points are known.
  std::array<uint32_t, Tile::kSide> positive{};
  std::array<uint32_t, Tile::kSide> unknown{};
};

// A tile changes the bounds of those around it.
template <typename Visitor>
void ForEachAround(TileKey key, Visitor visit) {
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const TileKey around{key.tx + dx, key.ty + dy};
      if (IsInRange(around)) visit(around);
    }
  }
}

// Of a tile that is absent and has none beside it: nothing, since no point is known.
std::optional<TileBounds> BoundsOfTile(const TileTree& tiles, TileKey key);

// The bounds of a map, made when somebody asks for them, and kept for others. Copies share them.
// Thread-safe but for Use().
class SurfaceBounds {
 public:
  // Of an empty map; of another.
  SurfaceBounds() : SurfaceBounds(std::make_shared<const MapView>()) {}
  explicit SurfaceBounds(std::shared_ptr<const MapView> map);

  // Those of another map; where it is a later view by the same SummedLayers, what did not change
  // stays. Other copies stay with their map, and keep nothing any more.
  void Use(std::shared_ptr<const MapView> map);
  bool KeepsBounds() const;

  const std::shared_ptr<const MapView>& map() const { return map_; }
  // Around all tiles that have bounds.
  const TileBox& box() const { return box_; }
  // Null where no point of the tile is known.
  std::shared_ptr<const TileBounds> Find(TileKey key) const;

 private:
  struct Kept;

  std::shared_ptr<const MapView> map_;
  TileBox box_;
  std::shared_ptr<Kept> kept_;
  uint64_t generation_ = 0;  // of what kept_ has, as long as it is of this map
};

// Finds bounds that were found before faster. Thread-compatible; outlived by what it was made of.
class BoundsReader {
 public:
  explicit BoundsReader(const SurfaceBounds& bounds) : bounds_(bounds) {}

  const TileBox& box() const { return bounds_.box(); }
  // Null where no point of the tile is known. Valid until the next call.
  const TileBounds* Find(TileKey key) {
    constexpr uint32_t kSide = 8;
    Found& found = found_[kSide * (static_cast<uint32_t>(key.ty) % kSide) +
                          static_cast<uint32_t>(key.tx) % kSide];
    if (!found.is_any || found.key != key) found = {true, key, bounds_.Find(key)};
    return found.bounds.get();
  }

 private:
  struct Found {
    bool is_any = false;
    TileKey key;
    std::shared_ptr<const TileBounds> bounds;
  };

  const SurfaceBounds& bounds_;
  std::array<Found, 64> found_;
};

}  // namespace splinemap
