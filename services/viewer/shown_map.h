#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_address.h"
#include "splinemap/follow_options.h"
#include "splinemap/layer_set.h"
#include "splinemap/map_view.h"
#include "splinemap/queryable_map.h"
#include "splinemap/utime.h"

namespace splinemap {

// Of a map that can be shown as it was at other times.
struct MapTimes {
  Utime first{0};  // of the scans that are kept
  Utime last{0};
  std::optional<Utime> shown;   // none: the map of now
  std::optional<Utime> wanted;  // the same, but while that map is made
  std::string problem;          // why it cannot be made; another one is shown
};

// The map that is shown. Thread-safe.
class ShownMap {
 public:
  virtual ~ShownMap() = default;

  virtual LayerSet Layers() const = 0;
  virtual std::shared_ptr<const MapView> View() const = 0;
  virtual const QueryableMap& map() const = 0;

  // Of a file that keeps scans.
  virtual std::optional<MapTimes> Times() const { return std::nullopt; }
  // The map as it was then, or that of now, as soon as it is made; what was wanted before and is
  // not made yet never is. Times beyond those of the scans are their first, and now.
  virtual void ShowAt(std::optional<Utime>) {}

  // Of a map on a bus, or of a fleet; a file has none of it.
  virtual std::vector<FollowedLayer> FollowedLayers() const { return {}; }
  virtual bool IsCaughtUp() const { return true; }
  virtual std::vector<std::string> Refused() const { return {}; }
  virtual std::string Problem() const { return ""; }
  virtual int64_t BytesReceived() const { return 0; }
};

// A replica of the map on a bus. `on_change` runs in its thread.
absl::StatusOr<std::unique_ptr<ShownMap>> FollowMap(const std::string& lcm_url,
                                                    const FollowOptions& options,
                                                    std::function<void()> on_change);
// A replica of the map of a fleet. `on_change` runs in its thread. Errors: those of
// NatsFleetStore::Connect(). Where the servers have no such map, they are asked again for it.
absl::StatusOr<std::unique_ptr<ShownMap>> FollowFleet(const FleetAddress& fleet,
                                                      std::function<void()> on_change);
// Where the file keeps scans, `on_change` runs in the thread that makes the map of other times.
// Errors: those of ReadMapFile(), and DataLoss where the file is damaged.
absl::StatusOr<std::unique_ptr<ShownMap>> OpenMap(const std::string& path,
                                                  std::function<void()> on_change);

}  // namespace splinemap
