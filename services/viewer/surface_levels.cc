#include "services/viewer/surface_levels.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "lib/tiles/coarser_tile.h"
#include "splinemap/surface.h"

namespace splinemap {
namespace {

constexpr int kMaxGreatest = 2;  // levels of the greatest log-odds

TileKey ParentOf(TileKey key) { return {key.tx >> 1, key.ty >> 1}; }

// A tile that is gone, once for all.
const std::shared_ptr<const StoredTile>& Nothing() {
  static const auto kNothing = std::make_shared<const StoredTile>();
  return kNothing;
}

ControlPoint LogOddsOfMean(double sum, int count) {
  if (count == 0) return 0;
  constexpr double kMost = 1e-7;
  const double p = std::clamp(sum / count, kMost, 1 - kMost);
  const long units = std::lround(kUnitsPerLogOdds * std::log(p / (1 - p)));
  return static_cast<ControlPoint>(units == 0 ? 1 : units);
}

}  // namespace

Tile MeanTile(const TileTree& finer, TileKey key) {
  constexpr int kHalf = Tile::kSide / 2;
  Tile mean;
  for (int quarter = 0; quarter < 4; ++quarter) {
    const int right = quarter % 2;
    const int upper = quarter / 2;
    const std::shared_ptr<const Tile> tile =
        FindTile(finer, {2 * key.tx + right, 2 * key.ty + upper});
    if (tile == nullptr) continue;
    for (int j = 0; j < kHalf; ++j) {
      for (int i = 0; i < kHalf; ++i) {
        double sum = 0;
        int count = 0;
        for (int k = 0; k < 4; ++k) {
          const ControlPoint point =
              tile->control_points[IndexInTile(2 * i + k % 2, 2 * j + k / 2)];
          if (point == 0) continue;
          sum += Probability(point / double{kUnitsPerLogOdds});
          ++count;
        }
        mean.control_points[IndexInTile(kHalf * right + i, kHalf * upper + j)] =
            LogOddsOfMean(sum, count);
      }
    }
  }
  return mean;
}

bool SurfaceLevels::Advance(const TileTree& tiles, int64_t utime_ms, size_t max_tiles) {
  if (tiles.version() != levels_[0].tiles.version()) SetFinest(tiles, utime_ms);
  bool is_left = false;
  for (int number = 1; number <= LevelOfDetail::kMaxLevel && !is_left; ++number) {
    MakeWaiting(number, utime_ms, max_tiles);
    is_left = !levels_[number].waiting.empty();
  }
  if (!is_left) is_first_ = levels_[0].changes.empty();
  return is_left;
}

const SurfaceLevels::Change* SurfaceLevels::FindChange(int level, TileKey key) const {
  const auto change = levels_[level].changes.find(key);
  return change == levels_[level].changes.end() ? nullptr : &change->second;
}

void SurfaceLevels::SetFinest(const TileTree& tiles, int64_t utime_ms) {
  const TileTree before = std::exchange(levels_[0].tiles, tiles);
  const bool continues = before.lineage() == tiles.lineage();
  if (!continues) box_ = {};
  tiles.ForEachChanged(continues ? before.version() : 0,
                       [&](TileKey key, const TileTree::Entry& entry) {
                         const StoredTile* old = before.Find(key);
                         if (old == nullptr || !HaveEqualContent(*old, *entry.tile)) {
                           SetChanged(0, key, utime_ms);
                         }
                         box_.Add(key);
                       });
  if (continues) return;
  before.ForEach([&](TileKey key, const TileTree::Entry&) {
    if (tiles.Find(key) == nullptr) SetChanged(0, key, utime_ms);
  });
}

void SurfaceLevels::MakeWaiting(int number, int64_t utime_ms, size_t& max_tiles) {
  Level& level = levels_[number];
  const TileTree& finer = levels_[number - 1].tiles;
  bool is_changed = false;
  for (auto it = level.waiting.begin(); it != level.waiting.end() && max_tiles > 0; --max_tiles) {
    const TileKey key = *it;
    level.waiting.erase(it++);
    Tile tile =
        number <= kMaxGreatest ? CoarserTile(finer, key, Statistic::kMax) : MeanTile(finer, key);
    const std::shared_ptr<const Tile> before = FindTile(level.editor.tree(), key);
    if (before == nullptr ? tile == Tile() : tile == *before) continue;
    level.editor.Put(key, tile == Tile() ? Nothing() : std::make_shared<const StoredTile>(tile),
                     last_change_);
    SetChanged(number, key, utime_ms);
    is_changed = true;
  }
  if (is_changed) level.tiles = level.editor.Freeze();
}

void SurfaceLevels::SetChanged(int number, TileKey key, int64_t utime_ms) {
  Level& level = levels_[number];
  level.newest_change = ++last_change_;
  level.changes[key] = {last_change_, is_first_ ? 0 : utime_ms};
  if (number < LevelOfDetail::kMaxLevel) levels_[number + 1].waiting.insert(ParentOf(key));
}

}  // namespace splinemap
