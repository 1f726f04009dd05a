#pragma once

#include <vector>

#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lib/base/utime.h"
#include "lib/sensing/pose_buffer.h"

namespace splinemap {

// Messages as a robot with bot_core types publishes them.
bot_core::pose_t PoseMessage(const TimedPose& pose);
bot_core::planar_lidar_t PlanarLidarMessage(Utime utime, std::vector<float> ranges_m,
                                            double first_bearing_rad, double bearing_step_rad);

}  // namespace splinemap
