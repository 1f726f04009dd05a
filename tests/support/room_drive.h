#pragma once

#include "absl/functional/function_ref.h"
#include "lib/sensing/pose_buffer.h"
#include "splinemap/scan.h"

namespace splinemap {

// How the driver of a sensor distorts what it measures.
struct RoomDriver {
  int sign = 1;
  double yaw_rad = 0;
  double stamp_late_s = 0;
  double duration_s = 0.1;  // of a turn of the sensor, while the robot moves on
  bool beam_times = false;
};

// A minute of a robot that drives and turns (`turn` times as much) in a room of 6 x 4 m: poses at
// 50 Hz, scans of 45 beams at 5 Hz.
void DriveInRoom(const RoomDriver& driver, double turn,
                 absl::FunctionRef<void(const TimedPose&)> on_pose,
                 absl::FunctionRef<void(RangeReadings)> on_scan);

}  // namespace splinemap
