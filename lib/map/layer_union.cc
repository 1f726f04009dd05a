#include "lib/map/layer_union.h"

#include <algorithm>
#include <utility>

#include "lib/base/status.h"

namespace splinemap {

LayerSnapshot Merge(const LayerSnapshot& a, const LayerSnapshot& b, int64_t& contradictions) {
  if (a.epoch != b.epoch) return a.epoch < b.epoch ? b : a;
  TileTreeEditor tiles(a.tiles);
  b.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const Tile* tile = a.tiles.Find(key);
    if (tile != nullptr) {
      const uint64_t revision = a.tiles.RevisionOf(key);
      const bool is_contradiction = revision == entry.revision && *tile != *entry.tile;
      contradictions += is_contradiction ? 1 : 0;
      if (revision > entry.revision) return;
      if (revision == entry.revision && tile->control_points >= entry.tile->control_points) return;
    }
    tiles.Put(key, entry.tile, entry.revision);
  });
  return {a.id, a.epoch, std::max(a.revision, b.revision), tiles.Freeze()};
}

absl::StatusOr<std::vector<LayerUnion::Clash>> LayerUnion::Take(const MapSnapshot& map) {
  LayerControls controls = controls_;
  controls.Take(map.controls);
  for (const auto& [id, control] : map.controls.records()) {
    if (Merge(controls.Of(id), control) == controls.Of(id)) continue;
    return FailedPrecondition("there are records about more than {} layers", LayerControls::kMax);
  }
  controls_ = std::move(controls);

  std::vector<Clash> clashes;
  for (const LayerSnapshot& layer : map.layers) {
    const auto [known, is_new] = layers_.try_emplace(layer.id, layer);
    if (is_new) continue;
    const auto [dropped, kept] = std::minmax(known->second.epoch, layer.epoch);
    Clash clash{layer.id, kept, dropped, known->second.epoch < layer.epoch};
    known->second = Merge(known->second, layer, clash.contradictions);
    if (clash.kept != clash.dropped || clash.contradictions > 0) clashes.push_back(clash);
  }
  return clashes;
}

std::vector<LayerId> LayerUnion::Removed() const {
  std::vector<LayerId> removed;
  for (const auto& [id, layer] : layers_) {
    if (controls_.Of(id).IsRemoved(layer.epoch)) removed.push_back(id);
  }
  return removed;
}

std::shared_ptr<const MapSnapshot> LayerUnion::Snapshot() const {
  Map map(options_);
  for (const auto& [id, layer] : layers_) {
    if (!controls_.Of(id).IsRemoved(layer.epoch)) map.ContinueLayer(layer, layer.epoch);
  }
  map.SetControls(controls_);
  return map.Snapshot();
}

}  // namespace splinemap
