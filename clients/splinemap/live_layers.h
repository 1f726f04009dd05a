#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "clients/splinemap/bus_flags.h"
#include "lcmtypes/splinemap/layers_t.hpp"

namespace splinemap {

// The layers that each daemon on the bus has, by name: of all daemons, or of those of `robot` where
// that is not empty. Asks and listens until the timeout. NotFound where
// none does.
absl::StatusOr<std::vector<layers_t>> ReceiveLayers(const BusFlags& bus, const std::string& robot);

}  // namespace splinemap
