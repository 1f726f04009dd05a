#pragma once

#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "splinemap/region.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace splinemap {

// Adds --region.
CLI::Option* AddRegionFlag(CLI::App& command, std::string& text);

// The region in the text of the flag: x0,y0,x1,y1 in metres; none for an empty text.
absl::StatusOr<std::optional<Region>> ParseRegion(const std::string& text);

}  // namespace splinemap
