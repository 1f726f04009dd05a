#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "absl/container/flat_hash_map.h"
#include "lib/layers/layer_pyramid.h"
#include "splinemap/layer_settings.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/region.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// A layer, or the sum of all, at every level of detail, and when each of its tiles changed. From
// level 1 on the greatest log-odds of the squares, so that walls do not vanish. Thread-compatible.
class SurfaceLevels {
 public:
  struct Change {
    uint64_t number = 0;   // greater than those of all changes before
    int64_t utime_ms = 0;  // 0: before the viewer was started
  };

  // Goes on with work towards the levels of `tiles`, at most `max_tiles` of it. `utime_ms` is now.
  // True where some is left.
  bool Advance(const TileTree& tiles, int64_t utime_ms, size_t max_tiles);

  const TileTree& tiles(int level) const { return levels_[level].tiles; }
  // Of a tile, of one that is gone too; none where it never was.
  const Change* FindChange(int level, TileKey key) const;
  // All numbers of changes at a level are up to this.
  uint64_t newest_change(int level) const { return levels_[level].newest_change; }
  // From the frame of its tiles to that of the map.
  KnotShift shift() const { return shift_; }
  void set_shift(KnotShift shift) { shift_ = shift; }
  // Around all tiles of level 0 that ever were.
  const TileBox& box() const { return box_; }

 private:
  struct Level {
    TileTree tiles;
    absl::flat_hash_map<TileKey, Change> changes;
    uint64_t newest_change = 0;
  };

  void Take(Level& level, const TileTree& tiles, int64_t utime_ms);

  std::array<Level, LevelOfDetail::kMaxLevel + 1> levels_;
  std::optional<LayerPyramid> pyramid_;
  uint64_t pyramid_lineage_ = 0;
  uint64_t revision_ = 0;  // counts trees, for the pyramid
  uint64_t last_change_ = 0;
  TileBox box_;
  KnotShift shift_;
};

}  // namespace splinemap
