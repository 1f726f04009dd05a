#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/follow_options.h"
#include "splinemap/layer_set.h"
#include "splinemap/map_view.h"
#include "splinemap/queryable_map.h"

namespace splinemap {

// The map that is shown. Thread-safe.
class ShownMap {
 public:
  virtual ~ShownMap() = default;

  virtual LayerSet Layers() const = 0;
  virtual std::shared_ptr<const MapView> View() const = 0;
  virtual const QueryableMap& map() const = 0;

  // Of a map on a bus; a file has none of it.
  virtual std::vector<FollowedLayer> FollowedLayers() const { return {}; }
  virtual bool IsCaughtUp() const { return true; }
  virtual std::vector<std::string> Refused() const { return {}; }
  virtual std::string BusProblem() const { return ""; }
  virtual int64_t BytesReceived() const { return 0; }
};

// A replica of the map on a bus. `on_change` runs in its thread.
absl::StatusOr<std::unique_ptr<ShownMap>> FollowMap(const std::string& lcm_url,
                                                    const FollowOptions& options,
                                                    std::function<void()> on_change);
// Errors: those of ReadMapFile(), and DataLoss where the file is damaged.
absl::StatusOr<std::unique_ptr<ShownMap>> OpenMap(const std::string& path);

}  // namespace splinemap
