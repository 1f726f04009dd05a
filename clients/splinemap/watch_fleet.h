#pragma once

#include <chrono>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_address.h"

namespace splinemap {

// `splinemap watch --fleet` in a terminal, until the user ends it: layers and a preview of the map.
absl::StatusOr<int> DrawFleet(const FleetAddress& address);

// A line a second about the whole of it; with `json` an object a line that has the layers. With
// `once` it ends after the first. Unavailable where the copy has not got on for `patience`.
absl::StatusOr<int> PrintFleet(const FleetAddress& address, std::chrono::milliseconds patience,
                               bool json, bool once);

}  // namespace splinemap
