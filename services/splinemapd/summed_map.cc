#include "services/splinemapd/summed_map.h"

namespace splinemap {

void SummedMap::SetOwn(LayerSnapshot own) {
  MutexLock lock(parts_mutex_);
  parts_.own = std::move(own);
  ++parts_.version;
}

void SummedMap::SetFollowed(std::vector<LayerSnapshot> followed, LayerControls controls) {
  MutexLock lock(parts_mutex_);
  parts_.followed = std::move(followed);
  parts_.controls = std::move(controls);
  ++parts_.version;
}

std::shared_ptr<const MapSnapshot> SummedMap::Snapshot() {
  MutexLock sum_lock(sum_mutex_);
  Parts parts;
  {
    MutexLock lock(parts_mutex_);
    if (snapshot_ && version_ == parts_.version) return snapshot_;
    parts = parts_;
  }
  auto snapshot = std::make_shared<MapSnapshot>();
  snapshot->options = options_;
  snapshot->own_layer = parts.own.id;
  snapshot->layers.push_back(std::move(parts.own));
  for (LayerSnapshot& layer : parts.followed) snapshot->layers.push_back(std::move(layer));
  snapshot->controls = std::move(parts.controls);
  snapshot->merged = merged_.Update(snapshot->layers, snapshot->controls, options_.limits);
  snapshot_ = std::move(snapshot);
  version_ = parts.version;
  return snapshot_;
}

}  // namespace splinemap
