#pragma once

#include <vector>

#include "splinemap/pose2.h"
#include "splinemap/utime.h"

namespace splinemap {

struct TrajectoryPose {
  Utime utime{0};
  Pose2 world_T_robot;
};

// Where a robot was, as a program that closes loops found it: stamps increase.
struct Trajectory {
  std::vector<TrajectoryPose> poses;
  // What the robot's localisation said from here on is right already; what it said between the last
  // pose and this moves with the last.
  Utime until{0};
};

}  // namespace splinemap
