#include "clients/splinemap/follow_fleet.h"

#include <thread>
#include <utility>
#include <vector>

#include "clients/splinemap/follow.h"
#include "lib/base/clock.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

// Grows while the copy gets on.
int64_t ProgressOf(const FleetReplica& replica) {
  if (!replica.HasCompared()) return replica.BytesReceived();
  return static_cast<int64_t>(replica.WholeLayers().layers.size());
}

std::string WhatIsNotWhole(const FleetReplica& replica) {
  const LayerSet whole = replica.WholeLayers();
  std::string missing;
  for (const FollowedLayer& layer : replica.FollowedLayers()) {
    if (whole.Find(layer.id) != nullptr) continue;
    missing += fmt::format("; {} has {} tiles so far", PlainText(layer.id.name), layer.tiles);
  }
  return missing;
}

absl::Status CheckLayers(const FollowedFleet& fleet, const std::vector<std::string>& robots) {
  const std::string& map = fleet.store->address().map;
  if (!fleet.replica->map_options()) {
    return NotFound("the fleet's map '{}' is empty: no robot has sent its layer yet", map);
  }
  const std::vector<FollowedLayer> layers = fleet.replica->FollowedLayers();
  for (const std::string& robot : robots) {
    if (HasLayerOf(layers, robot)) continue;
    return NotFound("the fleet's map '{}' has no layer of {}; splinemap layers lists them", map,
                    robot);
  }
  return absl::OkStatus();
}

}  // namespace

std::string FollowedFleet::Problem() const {
  const std::string lost = store->Problem();
  return lost.empty() ? replica->Problem() : lost;
}

absl::StatusOr<FollowedFleet> FollowFleet(const FleetAddress& address, FleetFollowOptions options) {
  FollowedFleet fleet;
  SPLINEMAP_ASSIGN_OR_RETURN(fleet.store, NatsFleetStore::Connect(address));
  // What time does not mend is said at once.
  const absl::Status map = fleet.store->Get(kMapKey).status();
  if (!map.ok() && !absl::IsOutOfRange(map)) return map;
  fleet.replica = std::make_unique<FleetReplica>(*fleet.store, std::move(options));
  return fleet;
}

absl::Status AwaitWhole(const FollowedFleet& fleet, const FleetFollowOptions& options,
                        std::chrono::milliseconds patience) {
  const FleetReplica& replica = *fleet.replica;
  int64_t progress = 0;
  for (auto since = Clock::now(); Clock::now() - since < patience;) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const int64_t now = ProgressOf(replica);
    const bool is_whole =
        !replica.map_options() || now == static_cast<int64_t>(replica.FollowedLayers().size());
    if (replica.HasCompared() && is_whole) return CheckLayers(fleet, options.names);
    if (std::exchange(progress, now) != now) since = Clock::now();
  }
  if (const std::string problem = fleet.Problem(); !problem.empty()) {
    return Unavailable("{}", problem);
  }
  return Unavailable(
      "the fleet's map '{}' did not become whole, and nothing new came for {:g} s{}; --timeout "
      "gives it more time",
      fleet.store->address().map, std::chrono::duration<double>(patience).count(),
      WhatIsNotWhole(replica));
}

absl::StatusOr<FollowedFleet> FollowWholeFleet(const FleetAddress& address,
                                               const FleetFollowOptions& options,
                                               std::chrono::milliseconds patience) {
  SPLINEMAP_ASSIGN_OR_RETURN(FollowedFleet fleet, FollowFleet(address, options));
  SPLINEMAP_RETURN_IF_ERROR(AwaitWhole(fleet, options, patience));
  return fleet;
}

}  // namespace splinemap
