#include "lib/map/merged_tiles.h"

#include <algorithm>
#include <deque>

#include "absl/container/flat_hash_set.h"
#include "lib/map/merge_tiles.h"
#include "lib/map/shifted_tile.h"

namespace splinemap {

TileTree MergedTiles::Update(const std::vector<LayerSnapshot>& layers,
                             const LayerControls& controls, ControlLimits limits) {
  std::vector<Summand> summands;
  for (const LayerSnapshot& layer : layers) {
    const LayerControl& control = controls.Of(layer.id);
    if (control.IsSummed()) summands.push_back({&layer, control.yields, control.shift});
  }
  if (!GoesOn(summands)) {
    merged_ = TileTreeEditor();
    seen_.clear();
  }
  // One layer is its own sum: its control points are within the limits already.
  if (summands.size() == 1 && !summands[0].yields && summands[0].shift == KnotShift{}) {
    return summands[0].layer->tiles;
  }
  absl::flat_hash_set<TileKey> changed;
  for (const Summand& summand : summands) {
    const auto& [layer, yields, shift] = summand;
    Seen& seen =
        seen_.try_emplace(layer->id, Seen{layer->epoch, yields, shift, layer->tiles.line()})
            .first->second;
    layer->tiles.ForEachChanged(seen.up_to, [&](TileKey key, const TileTree::Entry&) {
      for (const TileKey moved : KeysOfShifted(key, summand.shift)) changed.insert(moved);
    });
    seen.up_to = layer->tiles.epoch();
  }
  for (const TileKey& key : changed) MergeTile(key, summands, limits);
  return merged_.Freeze();
}

void MergedTiles::MergeTile(TileKey key, const std::vector<Summand>& summands,
                            ControlLimits limits) {
  std::vector<const Tile*>& tiles = tiles_;
  std::vector<const Tile*>& yielding = yielding_;
  std::deque<Tile> shifted;
  tiles.clear();
  yielding.clear();
  for (const auto& [layer, yields, shift] : summands) {
    const Tile* tile = shift == KnotShift{}
                           ? layer->tiles.Find(key)
                           : ShiftTile(layer->tiles, key, shift, shifted.emplace_back());
    if (tile != nullptr) (yields ? yielding : tiles).push_back(tile);
  }
  Tile yielded;
  if (!yielding.empty()) {
    const ControlLimits within{static_cast<ControlPoint>(limits.min * 4 / 5),
                               static_cast<ControlPoint>(limits.max * 4 / 5)};
    yielded = MergeTiles(yielding, within);
    tiles.push_back(&yielded);
  }
  // The shifted neighbours of a tile may have nothing of it.
  if (!tiles.empty()) merged_.Edit(key, 0) = MergeTiles(tiles, limits);
}

bool MergedTiles::GoesOn(const std::vector<Summand>& summands) const {
  size_t known = 0;
  for (const auto& [layer, yields, shift] : summands) {
    const auto seen = seen_.find(layer->id);
    if (seen == seen_.end()) continue;
    const Seen& before = seen->second;
    if (before.epoch != layer->epoch || before.yields != yields || before.shift != shift ||
        before.line != layer->tiles.line()) {
      return false;
    }
    ++known;
  }
  return known == seen_.size();
}

}  // namespace splinemap
