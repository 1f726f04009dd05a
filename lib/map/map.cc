#include "lib/map/map.h"

#include <array>
#include <cmath>
#include <utility>

#include "absl/container/flat_hash_set.h"

namespace splinemap {

SurfaceSample MapSnapshot::Evaluate(double x_m, double y_m) const {
  const auto x = LocateKnot(x_m, options.knot_interval_m);
  const auto y = LocateKnot(y_m, options.knot_interval_m);
  if (!x || !y) return {};
  ControlPatch patch = ControlPatch::Zero();
  TileKey cached_key;
  const TileTree::Entry* cached = nullptr;
  bool has_cached = false;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const int32_t i = x->index - 1 + column;
      const int32_t j = y->index - 1 + row;
      if (const TileKey key = TileOf(i, j); !has_cached || key != cached_key) {
        cached = merged.Find(key);
        cached_key = key;
        has_cached = true;
      }
      if (cached == nullptr) continue;
      patch(row, column) =
          cached->tile->control_points[IndexInTile(i, j)] / double{kUnitsPerLogOdds};
    }
  }
  SurfaceSample sample = EvaluatePatch(patch, x->t, y->t, options.knot_interval_m);
  sample.known = patch(y->t < 0.5 ? 1 : 2, x->t < 0.5 ? 1 : 2) != 0;
  return sample;
}

Tile MergeTiles(const std::vector<const Tile*>& tiles, ControlLimits limits) {
  std::array<int32_t, Tile::kSize> sums{};
  std::array<bool, Tile::kSize> touched{};
  for (const Tile* tile : tiles) {
    if (tile == nullptr) continue;
    for (int k = 0; k < Tile::kSize; ++k) {
      sums[k] += tile->control_points[k];
      touched[k] = touched[k] || tile->control_points[k] != 0;
    }
  }
  Tile merged;
  for (int k = 0; k < Tile::kSize; ++k) {
    if (touched[k]) merged.control_points[k] = ClampTouched(sums[k], limits);
  }
  return merged;
}

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
    for (const LayerSnapshot& layer : layers) {
      const TileTree::Entry* entry = layer.tiles.Find(key);
      tiles.push_back(entry == nullptr ? nullptr : entry->tile.get());
    }
    merged_.Edit(key, 0) = MergeTiles(tiles, options_.limits);
  }
}

}  // namespace splinemap
