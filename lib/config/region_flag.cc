#include "lib/config/region_flag.h"

#include <CLI/App.hpp>
#include <iterator>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/status.h"

namespace splinemap {

CLI::Option* AddRegionFlag(CLI::App& command, std::string& text) {
  return command
      .add_option("--region", text, "Only this part of the map, in metres of the map frame")
      ->type_name("X0,Y0,X1,Y1");
}

absl::StatusOr<std::optional<Region>> ParseRegion(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const std::vector<std::string> words = absl::StrSplit(text, ',');
  Region region;
  double* const numbers[] = {&region.x0_m, &region.y0_m, &region.x1_m, &region.y1_m};
  bool is_valid = words.size() == std::size(numbers);
  for (size_t k = 0; is_valid && k < words.size(); ++k) {
    is_valid = absl::SimpleAtod(words[k], numbers[k]);
  }
  if (!is_valid) return InvalidArgument("--region {} is not X0,Y0,X1,Y1 in metres", text);
  if (!(region.x0_m < region.x1_m && region.y0_m < region.y1_m)) {
    return InvalidArgument("--region {} is empty; give the lower left corner first", text);
  }
  return region;
}

}  // namespace splinemap
