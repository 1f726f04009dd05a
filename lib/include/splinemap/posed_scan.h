#pragma once

#include <vector>

#include "splinemap/fixed_pose2.h"
#include "splinemap/scan.h"

namespace splinemap {

// A scan and where its robot was: all that a map is made of, rounded as archives keep it.
struct PosedScan {
  int channel = 0;
  Utime utime{0};
  FixedPose2 world_T_robot;  // at utime; the frame of the robot's poses
  // Of all beams, or one for each of them where the robot moved or turned meanwhile, from where the
  // robot was at utime.
  std::vector<FixedPose2> robot_T_sensor;
  std::vector<Beam> beams;  // without time offsets
};

// A scan whose beams stand in the map.
struct PlacedScan {
  int channel = 0;
  Utime utime{0};
  Pose2 map_T_robot;  // at utime
  std::vector<PlacedBeam> beams;
};

// The pose of a robot in the map, rounded as it is used for placing scans.
FixedPose2 Placed(const FixedPose2& map_T_world, const FixedPose2& world_T_robot);

// Sets `placed`, and keeps its memory.
void Place(const PosedScan& scan, const FixedPose2& map_T_world, PlacedScan& placed);

}  // namespace splinemap
