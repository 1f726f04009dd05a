#pragma once

#include <string>
#include <vector>

#include "tests/bench/accuracy/effort.h"
#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// gp.csv: a Gaussian process against other maps in the circle of 2 m with range noise of 0.05 m,
// after few scans and after many. The process gets effort.gp_points of the points that the scans
// measured, drawn at random; length and noise are those of the greatest evidence.
void WriteGp(const std::vector<Method>& methods, const Effort& effort, const std::string& out);

}  // namespace splinemap
