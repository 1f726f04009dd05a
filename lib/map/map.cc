#include "lib/map/map.h"

#include <utility>

#include "absl/container/flat_hash_set.h"
#include "lib/map/merge_tiles.h"

namespace splinemap {

Layer& Map::AddLayer(LayerId id, LayerEpoch epoch) {
  merged_up_to_.push_back(0);
  return layers_.emplace_back(std::move(id), epoch);
}

Layer& Map::ContinueLayer(const LayerSnapshot& base, LayerEpoch epoch) {
  merged_up_to_.push_back(0);
  return layers_.emplace_back(base, epoch);
}

std::shared_ptr<const MapSnapshot> Map::Snapshot() {
  auto snapshot = std::make_shared<MapSnapshot>();
  snapshot->options = options_;
  for (Layer& layer : layers_) snapshot->layers.push_back(layer.Snapshot());
  if (layers_.size() == 1) {
    // One layer is its own sum: its control points are within the limits already.
    snapshot->merged = snapshot->layers.front().tiles;
  } else {
    UpdateMerged(snapshot->layers);
    snapshot->merged = merged_.Freeze();
  }
  return snapshot;
}

void Map::UpdateMerged(const std::vector<LayerSnapshot>& layers) {
  absl::flat_hash_set<TileKey> changed;
  for (size_t k = 0; k < layers.size(); ++k) {
    layers[k].tiles.ForEachChanged(
        merged_up_to_[k], [&](TileKey key, const TileTree::Entry&) { changed.insert(key); });
    merged_up_to_[k] = layers[k].tiles.epoch();
  }
  std::vector<const Tile*> tiles;
  for (const TileKey& key : changed) {
    tiles.clear();
    for (const LayerSnapshot& layer : layers) tiles.push_back(layer.tiles.Find(key));
    merged_.Edit(key, 0) = MergeTiles(tiles, options_.limits);
  }
}

}  // namespace splinemap
