#pragma once

#include <chrono>
#include <string>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/fleet_file.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// Since the copy was made, as far as the clocks of robots and of this computer agree; never
// negative.
std::chrono::duration<double> AgeOf(const FleetFile& file);

// Puts layers with scans in place of those of `map`, which come from the fleet's tiles, where
// robots have brought copies of their map files (lib/fleet/fleet_file.h), and prints for each
// layer, on stderr, what there is. Of a file, the robot's own layer alone counts. Copies lie beside
// `out` while they are read. Returns the exit status of a command that else succeeded: failed where
// a copy cannot be used. Errors: those of FleetStore.
absl::StatusOr<int> TakeScans(const FleetAddress& fleet, const std::string& out, LayerSet& map);

}  // namespace splinemap
