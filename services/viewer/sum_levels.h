#pragma once

#include <array>
#include <cmath>
#include <memory>

#include "lib/base/mutex.h"
#include "services/viewer/surface_levels.h"
#include "splinemap/map_view.h"

namespace splinemap {

// The newest sum of the layers at every level of detail, for pictures. Thread-safe.
class SumLevels {
 public:
  void Set(const SurfaceLevels& levels, const MapOptions& options) {
    MutexLock lock(mutex_);
    for (size_t n = 0; n < levels_.size(); ++n) levels_[n] = levels.tiles(static_cast<int>(n));
    options_ = options;
  }

  // The finest level whose knot interval is a pixel or more. Its control points stand for squares
  // of finer ones, so what it shows lies (2^level - 1) / 2 knot intervals of the map to the lower
  // left: offset_m.
  struct Shown {
    MapView map;
    double offset_m = 0;
  };
  Shown ForPixels(double pixel_m) const {
    MutexLock lock(mutex_);
    Shown shown;
    shown.map.options = options_;
    int level = 0;
    for (; level < LevelOfDetail::kMaxLevel && shown.map.options.knot_interval_m < pixel_m; ++level)
      shown.map.options.knot_interval_m *= 2;
    shown.map.tiles = levels_[level];
    shown.offset_m = (std::ldexp(1, level) - 1) / 2 * options_.knot_interval_m;
    return shown;
  }

 private:
  mutable Mutex mutex_;
  std::array<TileTree, LevelOfDetail::kMaxLevel + 1> levels_ ABSL_GUARDED_BY(mutex_);
  MapOptions options_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace splinemap
