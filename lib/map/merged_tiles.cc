#include "lib/map/merged_tiles.h"

#include "absl/container/flat_hash_set.h"
#include "lib/map/merge_tiles.h"

namespace splinemap {

TileTree MergedTiles::Update(const std::vector<LayerSnapshot>& layers, ControlLimits limits) {
  if (!GoesOn(layers)) {
    merged_ = TileTreeEditor();
    seen_.clear();
  }
  // One layer is its own sum: its control points are within the limits already.
  if (layers.size() == 1) return layers.front().tiles;
  absl::flat_hash_set<TileKey> changed;
  for (size_t k = 0; k < layers.size(); ++k) {
    if (k == seen_.size()) seen_.push_back({layers[k].id, layers[k].epoch});
    layers[k].tiles.ForEachChanged(
        seen_[k].up_to, [&](TileKey key, const TileTree::Entry&) { changed.insert(key); });
    seen_[k].up_to = layers[k].tiles.epoch();
  }
  std::vector<const Tile*> tiles;
  for (const TileKey& key : changed) {
    tiles.clear();
    for (const LayerSnapshot& layer : layers) tiles.push_back(layer.tiles.Find(key));
    merged_.Edit(key, 0) = MergeTiles(tiles, limits);
  }
  return merged_.Freeze();
}

bool MergedTiles::GoesOn(const std::vector<LayerSnapshot>& layers) const {
  if (layers.size() < seen_.size()) return false;
  for (size_t k = 0; k < seen_.size(); ++k) {
    if (layers[k].id != seen_[k].id || layers[k].epoch != seen_[k].epoch) return false;
  }
  return true;
}

}  // namespace splinemap
