#pragma once

#include <cstdint>
#include <string>

#include "absl/status/status.h"

namespace splinemap::bench {

// Writes the map of a robot that mapped this many tiles, all different and like those of a real
// map, and stopped.
absl::Status WriteMap(const std::string& path, const std::string& robot, int64_t tiles);

}  // namespace splinemap::bench
