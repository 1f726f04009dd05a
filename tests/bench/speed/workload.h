#pragma once

#include <Eigen/Geometry>
#include <optional>
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

// intel, freiburg_079: recorded drives; simulated_360_beams_3.5_m (the paper's lidar),
// simulated_1440_beams_25_m: a simulated one in an office. At most `max_scans`. Nothing, and a line
// on stderr, for another name and where the shared data folder is not there.
std::optional<Workload> MakeWorkload(const std::string& name, int max_scans);

// What the beams of all scans cover, and a metre around.
Eigen::AlignedBox2d BoundsOf(const Workload& workload);

}  // namespace splinemap::bench
