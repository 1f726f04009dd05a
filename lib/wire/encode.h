#pragma once

#include <cstdint>
#include <vector>

#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lib/sensing/pose_buffer.h"
#include "splinemap/utime.h"

namespace splinemap {

// The bytes of a message as they stand on the bus.
template <typename Message>
std::vector<uint8_t> Encode(const Message& message) {
  std::vector<uint8_t> bytes(message.getEncodedSize());
  message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
  return bytes;
}

// Messages as a robot with bot_core types publishes them.
bot_core::pose_t PoseMessage(const TimedPose& pose);
bot_core::planar_lidar_t PlanarLidarMessage(Utime utime, std::vector<float> ranges_m,
                                            double first_bearing_rad, double bearing_step_rad);

}  // namespace splinemap
