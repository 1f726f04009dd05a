#pragma once

#include <functional>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/matching/wall_fit.h"
#include "splinemap/pose2.h"

namespace splinemap {

// Where b may lie in a, at all headings and all shifts, the likeliest first: a few hundred poses
// a_T_b, each within Pull() of what it stands for. FailedPrecondition where the maps are too large.
//
// It correlates pictures of the maps in cells of 8 knot intervals, or 16 of large maps, by Fourier
// transforms: all shifts of a heading at once. `on_progress` is told what share is done. A place
// counts metres of walls of b that lie beside walls of a of the same direction, less what either
// map has a wall for in free space of the other. Directions are doubled angles, as complex numbers,
// for which the two faces of a thin wall are one.
absl::StatusOr<std::vector<Pose2>> SearchPoses(
    const MapPair& pair, const std::function<void(double share)>& on_progress);

}  // namespace splinemap
