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
    if (control.IsSummed()) summands.push_back({&layer, control.shift});
  }
  if (!GoesOn(summands)) {
    merged_ = TileTreeEditor();
    seen_.clear();
  }
  // One layer is its own sum: its control points are within the limits already.
  if (summands.size() == 1 && summands.front().shift == KnotShift{}) {
    return summands.front().layer->tiles;
  }
  absl::flat_hash_set<TileKey> changed;
  for (const auto& [layer, shift] : summands) {
    Seen& seen = seen_.try_emplace(layer->id, layer->epoch, shift).first->second;
    layer->tiles.ForEachChanged(seen.up_to, [&, shift = shift](TileKey key, const auto&) {
      for (const TileKey moved : KeysOfShifted(key, shift)) changed.insert(moved);
    });
    seen.up_to = layer->tiles.epoch();
  }
  std::vector<const Tile*> tiles;
  std::deque<Tile> shifted;
  for (const TileKey& key : changed) {
    tiles.clear();
    shifted.clear();
    for (const auto& [layer, shift] : summands) {
      tiles.push_back(shift == KnotShift{}
                          ? layer->tiles.Find(key)
                          : ShiftTile(layer->tiles, key, shift, shifted.emplace_back()));
    }
    // The shifted neighbours of a tile may have nothing of it.
    if (std::all_of(tiles.begin(), tiles.end(), [](const Tile* tile) { return !tile; })) continue;
    merged_.Edit(key, 0) = MergeTiles(tiles, limits);
  }
  return merged_.Freeze();
}

bool MergedTiles::GoesOn(const std::vector<Summand>& summands) const {
  size_t known = 0;
  for (const auto& [layer, shift] : summands) {
    const auto seen = seen_.find(layer->id);
    if (seen == seen_.end()) continue;
    if (seen->second.epoch != layer->epoch || seen->second.shift != shift) return false;
    ++known;
  }
  return known == seen_.size();
}

}  // namespace splinemap
