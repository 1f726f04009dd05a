#pragma once

#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// MRPT's COccupancyGridMap2D with simple beams; its cells are int8, 1/16 log-odds, clamped at 7.9.
// The insertion options differ from MRPT's defaults in two: no returns are ignored, and the
// greatest distance is 100 m (15). `free_probability` is the certainty of one free cell: MRPT takes
// three times its log-odds for a hit. Beams must lie on multiples of half a degree from the first.
Method MrptMethod(const std::string& name, double free_probability);

// MRPT's default certainty, and the one that gives the paper's kappa: -0.3, and so 0.9 for a hit.
inline constexpr double kMrptDefaultCertainty = 0.65;
inline constexpr double kMrptPaperCertainty = 0.5744;

}  // namespace splinemap
