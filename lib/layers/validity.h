#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// What can be true of a map, whoever says it: a message, a file, or a program that is about to
// write one. Who takes something checks it here before, and MapFile checks it again before it
// writes, so that nothing gets into a file that its reader refuses. All return InvalidArgument with
// the value that cannot be.

// A knot interval of 0.001 to 10,000 m (10 m at level 8 is 2,560 m) and limits around 0.
absl::Status CheckMapOptions(const MapOptions& options);
// A name of 1 to 256 bytes without a 0.
absl::Status CheckLayerId(const LayerId& id);
// Counts that leave room to count on.
absl::Status CheckSessionId(const SessionId& session);
absl::Status CheckRevision(uint64_t revision);
// A key that a TileTree takes, and control points within `limits`.
absl::Status CheckTile(TileKey key, const Tile& tile, ControlLimits limits);

}  // namespace splinemap
