#include "lib/wire/encode.h"

#include <cmath>
#include <utility>

namespace splinemap {

bot_core::pose_t PoseMessage(const TimedPose& pose) {
  bot_core::pose_t message{};
  message.utime = pose.utime.count();
  message.pos[0] = pose.world_T_robot.position_m.x();
  message.pos[1] = pose.world_T_robot.position_m.y();
  message.orientation[0] = std::cos(pose.world_T_robot.yaw_rad / 2);
  message.orientation[3] = std::sin(pose.world_T_robot.yaw_rad / 2);
  return message;
}

bot_core::planar_lidar_t PlanarLidarMessage(Utime utime, std::vector<float> ranges_m,
                                            double first_bearing_rad, double bearing_step_rad) {
  bot_core::planar_lidar_t message;
  message.utime = utime.count();
  message.nranges = static_cast<int32_t>(ranges_m.size());
  message.ranges = std::move(ranges_m);
  message.nintensities = 0;
  message.rad0 = static_cast<float>(first_bearing_rad);
  message.radstep = static_cast<float>(bearing_step_rad);
  return message;
}

}  // namespace splinemap
