#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/map/map.h"

namespace splinemap {

// The daemon's own layer and those that it follows, summed when somebody asks. Thread-safe.
class SummedMap {
 public:
  explicit SummedMap(MapOptions options) : options_(options) {}

  // These never wait for a sum.
  void SetOwn(LayerSnapshot own);
  void SetFollowed(std::vector<LayerSnapshot> followed, LayerControls controls);

  // As of the last of the above; its own layer first. Requires that there was a SetOwn().
  std::shared_ptr<const MapSnapshot> Snapshot();

 private:
  struct Parts {
    LayerSnapshot own;
    std::vector<LayerSnapshot> followed;
    LayerControls controls;
    uint64_t version = 0;
  };

  const MapOptions options_;
  Mutex parts_mutex_;
  Parts parts_ ABSL_GUARDED_BY(parts_mutex_);
  Mutex sum_mutex_ ABSL_ACQUIRED_BEFORE(parts_mutex_);
  MergedTiles merged_ ABSL_GUARDED_BY(sum_mutex_);
  std::shared_ptr<const MapSnapshot> snapshot_ ABSL_GUARDED_BY(sum_mutex_);
  uint64_t version_ ABSL_GUARDED_BY(sum_mutex_) = 0;  // of snapshot_
};

}  // namespace splinemap
