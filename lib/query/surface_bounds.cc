#include "lib/query/surface_bounds.h"

#include <algorithm>
#include <optional>

#include "absl/container/flat_hash_map.h"
#include "lib/base/mutex.h"

namespace splinemap {

namespace {

constexpr int kNone = std::numeric_limits<ControlPoint>::min();

// What some control points come to.
struct Extremes {
  int greatest_touched = kNone;
  int least = std::numeric_limits<ControlPoint>::max();

  void Add(int control_point) {
    greatest_touched = std::max(greatest_touched, control_point == 0 ? kNone : control_point);
    least = std::min(least, control_point);
  }
  void Add(const Extremes& other) {
    greatest_touched = std::max(greatest_touched, other.greatest_touched);
    least = std::min(least, other.least);
  }
};

// The control points that decide the cells of a tile: from -1 to 33 of it, each way.
class Neighbourhood {
 public:
  static constexpr int kSide = Tile::kSide + 3;

  Neighbourhood(const TileTree& tiles, TileKey key) {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const std::shared_ptr<const Tile> tile = FindTile(tiles, {key.tx + dx, key.ty + dy});
        if (tile != nullptr) Copy(*tile, Tile::kSide * dx, Tile::kSide * dy);
      }
    }
  }

  bool is_empty() const { return is_empty_; }

  void MarkCells(TileBounds& bounds) const {
    std::array<uint64_t, kSide> positive{};
    std::array<uint64_t, kSide> untouched{};
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        positive[y] |= uint64_t{rows_[y][x] > 0} << x;
        untouched[y] |= uint64_t{rows_[y][x] == 0} << x;
      }
      // Bit x: of the four (two) that decide cell x (are nearest to it), those of this row.
      positive[y] |= positive[y] >> 1;
      positive[y] |= positive[y] >> 2;
      untouched[y] = untouched[y] >> 1 | untouched[y] >> 2;
    }
    for (int y = 0; y < Tile::kSide; ++y) {
      bounds.positive[y] =
          static_cast<uint32_t>(positive[y] | positive[y + 1] | positive[y + 2] | positive[y + 3]);
      bounds.unknown[y] = static_cast<uint32_t>(untouched[y + 1] | untouched[y + 2]);
    }
  }

  Bounds OfBlock(int bx, int by) const {
    constexpr int kBlockSide = TileBounds::kBlockSide;
    Extremes extremes;
    bool all_touched = true;
    bool all_known = true;
    for (int y = kBlockSide * by; y < kBlockSide * (by + 1) + 3; ++y) {
      const bool row_is_nearest = y > kBlockSide * by && y <= kBlockSide * (by + 1) + 1;
      for (int x = kBlockSide * bx; x < kBlockSide * (bx + 1) + 3; ++x) {
        const int control_point = rows_[y][x];
        extremes.Add(control_point);
        if (control_point != 0) continue;
        all_touched = false;
        const bool is_nearest = x > kBlockSide * bx && x <= kBlockSide * (bx + 1) + 1;
        all_known = all_known && !(row_is_nearest && is_nearest);
      }
    }
    return BoundsOf(extremes.greatest_touched, extremes.least, all_touched, all_known);
  }

 private:
  // The part of a tile that lies in here; its first control point is (x0, y0) of the middle one.
  void Copy(const Tile& tile, int x0, int y0) {
    const int x_begin = std::max(x0, -1);
    const int x_end = std::min(x0 + Tile::kSide, kSide - 1);
    for (int y = std::max(y0, -1); y < std::min(y0 + Tile::kSide, kSide - 1); ++y) {
      const ControlPoint* row = &tile.control_points[Tile::kSide * (y - y0)];
      std::copy(row + x_begin - x0, row + x_end - x0, &rows_[y + 1][x_begin + 1]);
    }
    is_empty_ = false;
  }

  bool is_empty_ = true;
  std::array<std::array<ControlPoint, kSide>, kSide> rows_{};
};

}  // namespace

std::optional<TileBounds> BoundsOfTile(const TileTree& tiles, TileKey key) {
  const Neighbourhood neighbourhood(tiles, key);
  if (neighbourhood.is_empty()) return std::nullopt;
  TileBounds bounds;
  neighbourhood.MarkCells(bounds);
  bounds.whole.all_known = true;
  bounds.whole.lower = std::numeric_limits<float>::infinity();
  for (int by = 0; by < TileBounds::kBlocks; ++by) {
    for (int bx = 0; bx < TileBounds::kBlocks; ++bx) {
      const Bounds block = neighbourhood.OfBlock(bx, by);
      bounds.blocks[TileBounds::kBlocks * by + bx] = block;
      bounds.whole.upper = std::max(bounds.whole.upper, block.upper);
      bounds.whole.lower = std::min(bounds.whole.lower, block.lower);
      bounds.whole.all_known = bounds.whole.all_known && block.all_known;
    }
  }
  return bounds;
}

// Of one map after the other.
struct SurfaceBounds::Kept {
  static constexpr size_t kMaxTiles = 1 << 16;  // some 35 MB

  mutable Mutex mutex;
  uint64_t generation ABSL_GUARDED_BY(mutex) = 0;
  absl::flat_hash_map<TileKey, std::shared_ptr<const TileBounds>> tiles ABSL_GUARDED_BY(mutex);
};

SurfaceBounds::SurfaceBounds(std::shared_ptr<const MapView> map)
    : map_(std::make_shared<const MapView>()) {
  Use(std::move(map));
}

void SurfaceBounds::Use(std::shared_ptr<const MapView> map) {
  if (map == map_ && kept_ != nullptr) return;
  const TileTree& tiles = map->tiles;
  const uint64_t seen = map_->tiles.version();
  const bool goes_on = kept_ != nullptr && tiles.lineage() == map_->tiles.lineage() &&
                       tiles.version() >= seen && KeepsBounds();
  if (!goes_on) {
    kept_ = std::make_shared<Kept>();
    box_ = {};
  }
  MutexLock lock(kept_->mutex);
  tiles.ForEachChanged(goes_on ? seen : 0, [&](TileKey key, const TileTree::Entry&) {
    ForEachAround(key, [&](TileKey around) {
      box_.Add(around);
      if (!kept_->tiles.empty()) kept_->tiles.erase(around);
    });
  });
  generation_ = ++kept_->generation;
  map_ = std::move(map);
}

bool SurfaceBounds::KeepsBounds() const {
  MutexLock lock(kept_->mutex);
  return kept_->generation == generation_;
}

std::shared_ptr<const TileBounds> SurfaceBounds::Find(TileKey key) const {
  if (!box_.Contains(key)) return nullptr;
  {
    MutexLock lock(kept_->mutex);
    if (kept_->generation == generation_) {
      const auto found = kept_->tiles.find(key);
      if (found != kept_->tiles.end()) return found->second;
    }
  }
  const std::optional<TileBounds> made = BoundsOfTile(map_->tiles, key);
  auto bounds = made ? std::make_shared<const TileBounds>(*made) : nullptr;
  MutexLock lock(kept_->mutex);
  if (kept_->generation != generation_) return bounds;
  if (kept_->tiles.size() >= Kept::kMaxTiles) kept_->tiles.clear();
  kept_->tiles[key] = bounds;
  return bounds;
}

}  // namespace splinemap
