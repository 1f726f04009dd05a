#pragma once

#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// A truncated signed distance field in cells, as users of voxblox know it: along each beam from
// `truncation_cells` before the hit to as much behind it the cells average the distance along the
// beam to the hit, and cells further before it the truncation; weights are 1, and fall to 0 behind
// the hit from one cell on. Read bilinearly; minus the distance in cells stands for log-odds.
Method TsdfMethod(const std::string& name, double truncation_cells);

}  // namespace splinemap
