#include "lib/map/levels_of_detail.h"

#include <algorithm>
#include <utility>

#include "absl/container/flat_hash_set.h"
#include "lib/map/coarser_tile.h"

namespace splinemap {

LevelsOfDetail::LevelsOfDetail(int num_levels)
    : levels_(num_levels), level_at_work_(levels_.size()) {}

bool LevelsOfDetail::Advance(const LayerSnapshot& layer, size_t max_tiles) {
  if (level_at_work_ == levels_.size()) {
    const bool is_known = layer.tiles.epoch() == at_work_.tiles.epoch() &&
                          layer.revision == at_work_.revision && layer.epoch == at_work_.epoch;
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
    for (int band = 0; band < kNumBands; ++band) level.done[band] = level.tiles[band].Freeze();
  }
  done_ = {at_work_.id, at_work_.epoch, at_work_.revision, {}};
  is_done_ = true;
  return true;
}

LayerSnapshot LevelsOfDetail::Layer(Detail detail) const {
  LayerSnapshot layer = done_;
  layer.tiles = levels_[detail.level - 1].done[static_cast<int>(detail.band)];
  return layer;
}

LevelsOfDetail::Trees LevelsOfDetail::Finer(size_t level) {
  if (level == 0) return {at_work_.tiles, at_work_.tiles, at_work_.tiles};
  Trees trees;
  for (int band = 0; band < kNumBands; ++band) trees[band] = levels_[level - 1].tiles[band].tree();
  return trees;
}

// A tile is seen by the coarser one that it lies in, and by the low-pass of the next one.
void LevelsOfDetail::FindChanges(size_t level) {
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
    up_to = std::max(up_to, finer.epoch());
  };
  if (level == 0) {
    find(at_work_.tiles);
  } else {
    for (TileTreeEditor& band : levels_[level - 1].tiles) find(band.Freeze());
  }
  coarser.up_to = up_to;
  coarser.waiting.assign(changed.begin(), changed.end());
}

void LevelsOfDetail::Make(Level& level, const Trees& finer, TileKey key) {
  for (int band = 0; band < kNumBands; ++band) {
    auto tile = std::make_shared<const Tile>(CoarserTile(finer[band], key, Band(band)));
    const Tile* before = level.tiles[band].tree().Find(key);
    if (before == nullptr ? *tile == Tile() : *tile == *before) continue;
    level.tiles[band].Put(key, std::move(tile), at_work_.revision);
  }
}

}  // namespace splinemap
