#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/nats_fleet_store.h"

namespace splinemap {

// A copy of a fleet's map that follows it.
struct FollowedFleet {
  std::unique_ptr<NatsFleetStore> store;
  std::unique_ptr<FleetReplica> replica;

  // Why it does not get on at the moment; empty while it does.
  std::string Problem() const;
};
// Errors: those of NatsFleetStore::Connect(); NotFound where the servers have no such map.
absl::StatusOr<FollowedFleet> FollowFleet(const FleetAddress& address, FleetFollowOptions options);

// Waits until the copy has had each layer as a whole once, however long that takes while it gets
// on: WholeLayers() is what it has then. Unavailable, with what is missing, where there is no
// progress for `patience`; NotFound where the map is empty, or has no layer of one of
// `options.names`, as the copy was made with.
absl::Status AwaitWhole(const FollowedFleet& fleet, const FleetFollowOptions& options,
                        std::chrono::milliseconds patience);
// Both.
absl::StatusOr<FollowedFleet> FollowWholeFleet(const FleetAddress& address,
                                               const FleetFollowOptions& options,
                                               std::chrono::milliseconds patience);

}  // namespace splinemap
