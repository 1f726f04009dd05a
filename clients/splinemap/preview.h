#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "lib/map/map.h"

namespace splinemap {

// The map as text that fits the terminal on stdout with `other_rows` to spare; in colour where that
// is one. Errors as of FittingGrid().
absl::StatusOr<std::string> Preview(const MapSnapshot& map, int other_rows);

}  // namespace splinemap
