#pragma once

#include <array>
#include <cstdint>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/region.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// A layer as it is placed, or the sum of all, at every level of detail, and when each of its tiles
// changed. Control points of levels 1 and 2 are the greatest of the 2 x 2 below them, so that walls
// do not vanish; from there on the mean of the probabilities of those that are known, so that not
// all is wall from far. Thread-compatible.
class SurfaceLevels {
 public:
  struct Change {
    uint64_t number = 0;   // greater than those of all changes before
    int64_t utime_ms = 0;  // 0: before somebody looked
  };

  // Goes on with work towards the levels of `tiles`, at most `max_tiles` of it. `utime_ms` is now.
  // True where some is left.
  bool Advance(const TileTree& tiles, int64_t utime_ms, size_t max_tiles);

  const TileTree& tiles(int level) const { return levels_[level].tiles; }
  // Of a tile, of one that is gone too; none where it never was.
  const Change* FindChange(int level, TileKey key) const;
  // All numbers of changes at a level are up to this.
  uint64_t newest_change(int level) const { return levels_[level].newest_change; }
  // Around all tiles of level 0.
  const TileBox& box() const { return box_; }

 private:
  struct Level {
    TileTreeEditor editor;  // not of level 0
    TileTree tiles;
    absl::flat_hash_map<TileKey, Change> changes;
    uint64_t newest_change = 0;
    absl::flat_hash_set<TileKey> waiting;  // to be made of the level below
  };

  void SetFinest(const TileTree& tiles, int64_t utime_ms);
  void MakeWaiting(int number, int64_t utime_ms, size_t& max_tiles);
  void SetChanged(int number, TileKey key, int64_t utime_ms);

  std::array<Level, LevelOfDetail::kMaxLevel + 1> levels_;
  uint64_t last_change_ = 0;
  bool is_first_ = true;
  TileBox box_;
};

// Tile `key` of a level above that of `finer`, of the mean probabilities of squares of 2 x 2
// control points, of those that were touched; all zeros where none was.
Tile MeanTile(const TileTree& finer, TileKey key);

}  // namespace splinemap
