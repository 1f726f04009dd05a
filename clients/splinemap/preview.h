#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "lib/map/map_view.h"

namespace splinemap {

// The map as text that fits the terminal on stdout with `other_rows` to spare; in colour where that
// is one. Errors as of FittingGrid().
absl::StatusOr<std::string> Preview(const MapView& map, int other_rows);

}  // namespace splinemap
