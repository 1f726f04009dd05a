#include "lib/map/map.h"

#include <utility>

namespace splinemap {

Layer& Map::AddLayer(LayerId id, LayerEpoch epoch) {
  return layers_.emplace_back(std::move(id), epoch);
}

Layer& Map::ContinueLayer(const LayerSnapshot& base, LayerEpoch epoch) {
  return layers_.emplace_back(base, epoch);
}

std::shared_ptr<const MapSnapshot> Map::Snapshot() {
  auto snapshot = std::make_shared<MapSnapshot>();
  snapshot->options = options_;
  for (Layer& layer : layers_) snapshot->layers.push_back(layer.Snapshot());
  snapshot->controls = controls_;
  snapshot->own_layer = own_layer_;
  snapshot->merged = merged_.Update(snapshot->layers, snapshot->controls, options_.limits);
  return snapshot;
}

}  // namespace splinemap
