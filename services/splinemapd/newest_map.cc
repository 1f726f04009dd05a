#include "services/splinemapd/newest_map.h"

namespace splinemap {

void NewestMap::SetOwn(LayerSnapshot own) {
  MutexLock lock(mutex_);
  own_ = std::move(own);
  layers_.reset();
}

void NewestMap::SetFollowed(std::vector<LayerSnapshot> followed, SettingsTable settings) {
  MutexLock lock(mutex_);
  followed_ = std::move(followed);
  settings_ = std::move(settings);
  layers_.reset();
}

LayerSnapshot NewestMap::Own() const {
  MutexLock lock(mutex_);
  return own_;
}

std::shared_ptr<const LayerSet> NewestMap::Layers() {
  MutexLock lock(mutex_);
  if (layers_) return layers_;
  auto layers = std::make_shared<LayerSet>();
  layers->options = options_;
  layers->own_layer = own_.id;
  layers->layers.push_back(own_);
  layers->layers.insert(layers->layers.end(), followed_.begin(), followed_.end());
  layers->settings = settings_;
  layers_ = std::move(layers);
  return layers_;
}

std::shared_ptr<const MapView> NewestMap::View() {
  MutexLock lock(sum_mutex_);
  auto layers = Layers();
  if (layers != summed_) {
    view_ = sum_.Update(*layers);
    summed_ = std::move(layers);
  }
  return view_;
}

}  // namespace splinemap
