#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "splinemap/map_view.h"

namespace splinemap {

// The map as text that fits the terminal on stdout and leaves `other_rows` free, in colour where
// stdout is a terminal. Errors: those of FittingGrid().
absl::StatusOr<std::string> Preview(const MapView& map, int other_rows);

}  // namespace splinemap
