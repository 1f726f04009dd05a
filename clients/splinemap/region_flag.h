#pragma once

#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "lib/tiles/region.h"

namespace splinemap {

// What --region says: x0,y0,x1,y1 in metres, or nothing.
absl::StatusOr<std::optional<Region>> ParseRegion(const std::string& text);

}  // namespace splinemap
