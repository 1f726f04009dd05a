#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/trajectory.h"

namespace splinemap {

// Reads lines utime,x_m,y_m,yaw_rad, plain or gzip; a first line that begins with a letter is a
// header. Or the poses of the laser in a CARMEN log, stamped as RepairTimes() does. InvalidArgument
// names the line.
absl::StatusOr<std::vector<TrajectoryPose>> ReadTrajectory(const std::string& path, double rate_hz);

}  // namespace splinemap
