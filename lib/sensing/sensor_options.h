#pragma once

#include "lib/base/utime.h"
#include "lib/geometry/pose2.h"

namespace splinemap {

// How the messages of one scan channel are to be read. Defaults are the paper's for ranges.
struct SensorOptions {
  // +1 where bearings turn counter-clockwise seen from above, -1 where clockwise (or the sensor
  // hangs upside down).
  int bearing_sign = 1;

  // Added to the time stamp of every message.
  Utime time_offset{0};
  // Time from the first listed beam to the last. Negative where the message lists the beams against
  // the turning of the sensor, so that the last one is the oldest. Ignored with use_beam_times.
  Utime scan_duration{0};
  // Takes the time of each beam from the message.
  bool use_beam_times = false;

  // Readings below range_min_m are ignored; readings at or above range_max_m are no returns.
  double range_min_m = 0.05;
  double range_max_m = 30;
  // What a beam without return means: nothing (false), or free space up to range_max_m (true).
  bool no_return_is_free = false;

  Pose2 robot_T_sensor;
};

}  // namespace splinemap
