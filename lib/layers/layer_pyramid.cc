#include "lib/layers/layer_pyramid.h"

#include <algorithm>
#include <utility>

#include "absl/container/flat_hash_set.h"
#include "lib/tiles/coarser_tile.h"

namespace splinemap {

LayerPyramid::LayerPyramid(int num_levels) : levels_(num_levels), level_at_work_(levels_.size()) {}

bool LayerPyramid::Advance(const LayerSnapshot& layer, size_t max_tiles) {
  if (level_at_work_ == levels_.size()) {
    const bool is_known = layer.tiles.version() == at_work_.tiles.version() &&
                          layer.revision == at_work_.revision && layer.session == at_work_.session;
    if (is_known) return false;
    at_work_ = layer;
    level_at_work_ = 0;
    FindChanges(0);
  }
  while (true) {
    Level& level = levels_[level_at_work_];
    const Trees finer = Finer(level_at_work_);
    while (!level.waiting.empty()) {
      if (max_tiles-- == 0) return false;
      Make(level, finer, level.waiting.back());
      level.waiting.pop_back();
    }
    if (++level_at_work_ == levels_.size()) break;
    FindChanges(level_at_work_);
  }
  for (Level& level : levels_) {
    for (int statistic = 0; statistic < kNumStatistics; ++statistic)
      level.done[statistic] = level.tiles[statistic].Freeze();
  }
  done_ = {at_work_.id, at_work_.session, at_work_.revision, {}};
  is_done_ = true;
  return true;
}

LayerSnapshot LayerPyramid::Layer(LevelOfDetail level_of_detail) const {
  LayerSnapshot layer = done_;
  layer.tiles =
      levels_[level_of_detail.level - 1].done[static_cast<int>(level_of_detail.statistic)];
  return layer;
}

LayerPyramid::Trees LayerPyramid::Finer(size_t level) {
  if (level == 0) return {at_work_.tiles, at_work_.tiles, at_work_.tiles};
  Trees trees;
  for (int statistic = 0; statistic < kNumStatistics; ++statistic)
    trees[statistic] = levels_[level - 1].tiles[statistic].tree();
  return trees;
}

// A tile is seen by the coarser one that it lies in, and by the low-pass of the next one.
void LayerPyramid::FindChanges(size_t level) {
  Level& coarser = levels_[level];
  uint64_t up_to = coarser.up_to;
  absl::flat_hash_set<TileKey> changed;
  const auto find = [&](const TileTree& finer) {
    finer.ForEachChanged(coarser.up_to, [&](TileKey key, const TileTree::Entry&) {
      // Of an even one the neighbour before, of an odd one that after it.
      const TileKey parent{key.tx >> 1, key.ty >> 1};
      const int32_t beside_x = parent.tx + ((key.tx & 1) != 0 ? 1 : -1);
      const int32_t beside_y = parent.ty + ((key.ty & 1) != 0 ? 1 : -1);
      for (const int32_t ty : {parent.ty, beside_y}) {
        for (const int32_t tx : {parent.tx, beside_x}) changed.insert({tx, ty});
      }
    });
    up_to = std::max(up_to, finer.version());
  };
  if (level == 0) {
    find(at_work_.tiles);
  } else {
    for (TileTreeEditor& statistic : levels_[level - 1].tiles) find(statistic.Freeze());
  }
  coarser.up_to = up_to;
  coarser.waiting.assign(changed.begin(), changed.end());
}

void LayerPyramid::Make(Level& level, const Trees& finer, TileKey key) {
  for (int statistic = 0; statistic < kNumStatistics; ++statistic) {
    const Tile tile = CoarserTile(finer[statistic], key, Statistic(statistic));
    const auto before = FindTile(level.tiles[statistic].tree(), key);
    if (tile == (before == nullptr ? Tile() : *before)) continue;
    level.tiles[statistic].Put(key, std::make_shared<const StoredTile>(tile), at_work_.revision);
  }
}

}  // namespace splinemap
