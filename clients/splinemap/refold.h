#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "lib/mapping/archive_edit.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// Makes layers of `set` anew from their scans, as `edit_of` says of each archive, with a progress
// bar, and with `options` in place of those of the set. All layers, or those that `names` name; the
// others stay. Errors name the layer.
using EditOf = absl::FunctionRef<absl::StatusOr<ArchiveEdit>(const ScanArchive&)>;
absl::Status Refold(LayerSet& set, const std::vector<std::string>& names, EditOf edit_of,
                    const std::optional<MapOptions>& options = std::nullopt);

// The map as it was at a time of the command line.
absl::Status WindBack(LayerSet& set, const std::string& time);

}  // namespace splinemap
