#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/map/summed_layers.h"

namespace splinemap {

// The newest state of the daemon's own layer and of those that it follows. `memory` bounds the
// tiles of its sum. Thread-safe.
class NewestMap {
 public:
  NewestMap(MapOptions options, LayerSnapshot own, std::shared_ptr<TileMemory> memory = nullptr)
      : options_(options), own_(std::move(own)), sum_(LevelOfDetail(), std::move(memory)) {}

  // These never wait for a sum.
  void SetOwn(LayerSnapshot own);
  void SetFollowed(std::vector<LayerSnapshot> followed, SettingsTable settings);

  // The own layer.
  LayerSnapshot Own() const;
  // As of the last of the above; the own layer first. The same object until one of them is called.
  std::shared_ptr<const LayerSet> Layers();
  // Their sum, made when somebody asks: costs what changed since the last call.
  std::shared_ptr<const MapView> View();

 private:
  const MapOptions options_;
  mutable Mutex mutex_;
  LayerSnapshot own_ ABSL_GUARDED_BY(mutex_);
  std::vector<LayerSnapshot> followed_ ABSL_GUARDED_BY(mutex_);
  SettingsTable settings_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const LayerSet> layers_ ABSL_GUARDED_BY(mutex_);  // null where it is to be made

  Mutex sum_mutex_ ABSL_ACQUIRED_BEFORE(mutex_);
  SummedLayers sum_ ABSL_GUARDED_BY(sum_mutex_);
  std::shared_ptr<const LayerSet> summed_ ABSL_GUARDED_BY(sum_mutex_);  // of view_
  std::shared_ptr<const MapView> view_ ABSL_GUARDED_BY(sum_mutex_);
};

}  // namespace splinemap
