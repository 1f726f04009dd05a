#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/map/map.h"

namespace splinemap {

// The map without these layers, and records by `writer` that remove them, so that no union with
// older copies brings them back. FailedPrecondition where there is no room for such a record.
absl::StatusOr<std::shared_ptr<const MapSnapshot>> WithoutLayers(const MapSnapshot& map,
                                                                 const std::vector<LayerId>& ids,
                                                                 uint64_t writer);

// One layer that is the sum of the map as its records say, and no records. Its revision counts the
// commits that are in the sum.
std::shared_ptr<const MapSnapshot> Flattened(const MapSnapshot& map, LayerId id, LayerEpoch epoch);

}  // namespace splinemap
