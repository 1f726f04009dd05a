#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "tests/support/recorded_drive.h"

namespace splinemap::bench {

// Knot interval and cell size of every map.
inline constexpr double kResolution_m = 0.05;

// A drive in memory, as every mapper gets it: beams without return are left out already.
struct Workload {
  std::string name;
  int num_beams = 0;  // of a sweep, those without return included
  double first_bearing_rad = 0;
  double bearing_step_rad = 0;
  std::vector<RecordedScan> scans;
};

// Two recorded drives, left out in words where the shared data folder is not there, and two
// simulated ones. At most `max_scans` of each.
std::vector<Workload> MakeWorkloads(int max_scans);

// What the beams of all scans cover, and a metre around.
Eigen::AlignedBox2d BoundsOf(const Workload& workload);

}  // namespace splinemap::bench
