#pragma once

#include <string>
#include <vector>

#include "tests/bench/accuracy/drives.h"
#include "tests/bench/accuracy/effort.h"
#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// defaults.csv: all measures side by side, a row for each choice of defaults. Rooms as in the
// paper's figures (Fig. 3: mean over the half sides; Fig. 5: median at sigma 0.05 m), drives at
// 0.05 m, the door after 100 scans.
void WriteDefaults(const std::vector<Method>& methods, const std::vector<JudgedDrive>& drives,
                   const Effort& effort, const std::string& out);

}  // namespace splinemap
