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
  snapshot->merged = merged_.Update(snapshot->layers, options_.limits);
  return snapshot;
}

}  // namespace splinemap
