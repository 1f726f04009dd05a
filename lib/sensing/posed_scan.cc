#include "splinemap/posed_scan.h"

namespace splinemap {

FixedPose2 Placed(const FixedPose2& map_T_world, const FixedPose2& world_T_robot) {
  if (map_T_world.IsIdentity()) return world_T_robot;
  return FixedPose2::Nearest(map_T_world.ToPose() * world_T_robot.ToPose());
}

void Place(const PosedScan& scan, const FixedPose2& map_T_world, PlacedScan& placed) {
  placed.channel = scan.channel;
  placed.utime = scan.utime;
  placed.map_T_robot = Placed(map_T_world, scan.world_T_robot).ToPose();
  std::vector<Pose2> map_T_sensor;
  map_T_sensor.reserve(scan.robot_T_sensor.size());
  for (const FixedPose2& robot_T_sensor : scan.robot_T_sensor) {
    map_T_sensor.push_back(placed.map_T_robot * robot_T_sensor.ToPose());
  }
  Place(scan.beams, map_T_sensor, placed.beams);
}

}  // namespace splinemap
