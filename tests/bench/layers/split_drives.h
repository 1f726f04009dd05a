#pragma once

#include <string>
#include <vector>

#include "tests/bench/accuracy/drives.h"

namespace splinemap {

// split_drives.csv: each drive shared out to robots, by stretches that follow each other or scan by
// scan in turn, and judged by the scans that were held back. split_drives_mean.csv: the mean over
// the drives, and how much it is above that of one robot that mapped all with the defaults.
void WriteSplitDrives(const std::vector<JudgedDrive>& drives, const std::vector<size_t>& robots,
                      const std::string& out);

}  // namespace splinemap
