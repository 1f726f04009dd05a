#pragma once

#include <optional>

#include "splinemap/map_view.h"
#include "splinemap/pose2.h"

namespace splinemap {

// How m-explore (package multirobot_map_merge) aligns maps whose poses it does not know, with its
// defaults: grids of 5 cm, unknown 255, free 0, occupied 100, as images; AKAZE features; OpenCV's
// matcher of partial affine transforms, taken from a confidence of 1 on. Nothing where it finds
// none.
std::optional<Pose2> AlignByFeatures(const MapView& a, const MapView& b);

}  // namespace splinemap
