#pragma once

#include <Eigen/Core>

#include "absl/types/span.h"

namespace splinemap {

// How sharp a map of these hits would be: the effective number of cells of 5 cm that they lie in,
// exp(-sum p ln p) over the shares p of the cells (the Hill number of order 1). Fewer is sharper,
// where the same beams are placed in different ways; 0 without hits.
double HitEntropy(absl::Span<const Eigen::Vector2d> hits_world_m);

}  // namespace splinemap
