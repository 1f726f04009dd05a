#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// The set without these layers, and with settings by `writer` that remove them, so that no union
// with older copies brings them back. FailedPrecondition where there is no room for such a setting.
absl::StatusOr<LayerSet> WithoutLayers(const LayerSet& set, const std::vector<LayerId>& ids,
                                       uint64_t writer);

}  // namespace splinemap
