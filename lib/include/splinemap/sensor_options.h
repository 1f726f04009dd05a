#pragma once

#include <vector>

#include "splinemap/pose2.h"
#include "splinemap/utime.h"

namespace splinemap {

// Where a sensor sits on the robot.
struct SensorMount {
  Pose2 robot_T_sensor;
  bool is_upside_down = false;  // its bearings turn the other way, seen from above
};
inline constexpr double kMaxSensorDistance_m = 100;

// Bearings from `from_rad` counter-clockwise over `span_rad`, both ends included.
struct BearingRange {
  double from_rad = 0;
  double span_rad = 0;  // (0, 2 pi)
};

// How the messages of one scan channel are to be read. Defaults are the paper's for ranges.
struct SensorOptions {
  // +1 where bearings turn counter-clockwise seen from above, -1 where clockwise (or the sensor
  // hangs upside down).
  int bearing_sign = 1;

  // Stretches bearings about the sensor's x axis until a scan spans this angle; 0: as messages say.
  double field_of_view_rad = 0;

  // Takes the time at which the message was received in place of its time stamp; beam times are
  // shifted with it.
  bool stamp_is_receipt = false;
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
  // Readings from 0 to here are no returns too: some drivers have a small number for it.
  double no_return_up_to_m = 0;
  // What a beam without return means: nothing (false), or free space up to range_max_m (true).
  bool no_return_is_free = false;

  // Beams to leave out, because the robot itself is there. In the sensor's frame, after
  // bearing_sign.
  std::vector<BearingRange> masks;
  // Takes the first beam and then every n-th; the time per scan falls with it.
  int every_nth_beam = 1;

  // A scan is left out while the robot has moved less than both since the last one mapped of its
  // channel. A criterion of 0 is not looked at; both 0: every scan is mapped.
  double min_travel_m = 0;
  double min_turn_rad = 0;

  SensorMount mount;
};

}  // namespace splinemap
