#include "services/viewer/surface_levels.h"

#include <utility>

namespace splinemap {

bool SurfaceLevels::Advance(const TileTree& tiles, int64_t utime_ms, size_t max_tiles) {
  Level& finest = levels_[0];
  if (tiles.version() != finest.tiles.version()) {
    Take(finest, tiles, utime_ms);
    ++revision_;
  }
  // Tiles may be gone only where the tree is another.
  if (!pyramid_ || pyramid_lineage_ != tiles.lineage()) {
    pyramid_.emplace(LevelOfDetail::kMaxLevel);
    pyramid_lineage_ = tiles.lineage();
  }
  LayerSnapshot layer;
  layer.revision = revision_;
  layer.tiles = tiles;
  if (pyramid_->Advance(layer, max_tiles)) {
    for (int level = 1; level <= LevelOfDetail::kMaxLevel; ++level) {
      Take(levels_[level], pyramid_->Layer({level, Statistic::kMax}).tiles, utime_ms);
    }
  }
  return pyramid_->IsAtWork(layer);
}

const SurfaceLevels::Change* SurfaceLevels::FindChange(int level, TileKey key) const {
  const auto change = levels_[level].changes.find(key);
  return change == levels_[level].changes.end() ? nullptr : &change->second;
}

void SurfaceLevels::Take(Level& level, const TileTree& tiles, int64_t utime_ms) {
  const TileTree before = std::exchange(level.tiles, tiles);
  const bool is_first = level.changes.empty();
  const auto change = [&](TileKey key) {
    level.changes[key] = {++last_change_, is_first ? 0 : utime_ms};
    if (&level == &levels_[0]) box_.Add(key);
  };
  const bool continues = before.lineage() == tiles.lineage();
  tiles.ForEachChanged(continues ? before.version() : 0,
                       [&](TileKey key, const TileTree::Entry& entry) {
                         const Tile* old = before.Find(key);
                         if (old == nullptr || *old != *entry.tile) change(key);
                       });
  if (!continues) {
    before.ForEach([&](TileKey key, const TileTree::Entry&) {
      if (tiles.Find(key) == nullptr) change(key);
    });
  }
  level.newest_change = last_change_;
}

}  // namespace splinemap
