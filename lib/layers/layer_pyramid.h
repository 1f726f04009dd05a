#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "splinemap/layer.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The coarser levels of one layer, each made of the one below it by CoarserTile(), a piece at a
// time. Thread-compatible.
class LayerPyramid {
 public:
  // Of levels 1 .. num_levels, at most LevelOfDetail::kMaxLevel. More levels cost about as much
  // memory as the layer in all.
  explicit LayerPyramid(int num_levels);

  int num_levels() const { return static_cast<int>(levels_.size()); }

  // Goes on with work on the levels of `layer`, or of what it was given before, if that is not done
  // yet: at most `max_tiles` of each statistic. True where that made a new state.
  bool Advance(const LayerSnapshot& layer, size_t max_tiles);

  // Whether `layer` is not what was done last.
  bool IsAtWork(const LayerSnapshot& layer) const {
    return !is_done_ || done_.revision != layer.revision;
  }
  // Whether a state was ever done.
  bool HasLayers() const { return is_done_; }
  // The last state that was done. Requires a level of 1 .. num_levels, and HasLayers().
  LayerSnapshot Layer(LevelOfDetail level_of_detail) const;

 private:
  using Trees = std::array<TileTree, kNumStatistics>;
  struct Level {
    std::array<TileTreeEditor, kNumStatistics> tiles;
    Trees done;
    uint64_t up_to = 0;            // version of the trees of the finer level
    std::vector<TileKey> waiting;  // keys of this level
  };

  Trees Finer(size_t level);
  void FindChanges(size_t level);
  void Make(Level& level, const Trees& finer, TileKey key);

  std::vector<Level> levels_;  // levels_[n] is level n + 1
  LayerSnapshot at_work_;
  size_t level_at_work_ = 0;  // levels_.size(): nothing to do
  LayerSnapshot done_;        // without tiles
  bool is_done_ = false;
};

}  // namespace splinemap
