#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "splinemap/sensor_options.h"
#include "splinemap/utime.h"

namespace splinemap {

// One message of a range scanner as its sender meant it: nothing filtered, any dialect.
struct RangeReadings {
  Utime utime{0};
  std::vector<float> ranges_m;
  std::vector<float> bearings_rad;  // as many as ranges_m; sense of rotation by dialect
  std::vector<Utime> beam_utimes;   // as many as ranges_m, or empty
};

// The same readings at another time, those of their beams too.
RangeReadings At(RangeReadings readings, Utime utime);

// The angle that bearings at equal steps span, with the step behind the last one where their number
// is even, as of scanners that measure all round or half a turn; 0 where the steps are not equal.
double FieldOfView(absl::Span<const float> bearings_rad);

// Whether the beam times of a message may tell when its beams were: there are some, each near the
// message's time, and they are not all the same (to 10 ms), as from drivers that stamp whole scans.
bool HaveUsefulBeamTimes(const RangeReadings& readings);

// One beam that says something about the world.
struct Beam {
  float range_m = 0;
  float bearing_rad = 0;  // counter-clockwise from the sensor's x axis
  Utime time_offset{0};   // from the scan's utime
  bool hit = true;        // false: free up to range_m, and nothing is known about what follows
  uint16_t reading = 0;   // its number in the message
};

// A scan ready to be placed by poses.
struct Scan {
  int channel = 0;      // index of the scan channel, for order among scans of one time
  Utime utime{0};       // after the time offset
  Utime first_beam{0};  // earliest and latest time of a beam, from utime
  Utime last_beam{0};
  Pose2 robot_T_sensor;
  std::vector<Beam> beams;
};

// A beam in the world frame.
struct PlacedBeam {
  Eigen::Vector2d origin_world_m;
  Eigen::Vector2d direction_world;  // unit length
  double range_m = 0;
  bool hit = true;
};

// Sets `placed` to the beams in the world frame, their sensor at the one pose given or each at a
// pose of its own.
void Place(absl::Span<const Beam> beams, absl::Span<const Pose2> world_T_sensor,
           std::vector<PlacedBeam>& placed);

// Of a robot that is tilted by more than 10 degrees no planar map can be made: it sees the floor,
// or over the walls. `up_robot` is the world's z axis in its frame, a unit vector.
bool IsTiltedTooMuch(const Eigen::Vector3d& up_robot);

// Turns beams of a tilted robot, or of one that is upside down, out of its plane, and shortens them
// to what they reach in the horizontal one; those of a robot that is level to half a degree stay.
// Their sensor is turned by `sensor_yaw_rad` on the robot.
void Level(double sensor_yaw_rad, const Eigen::Vector3d& up_robot, absl::Span<Beam> beams);

// Most beams of one scan. With it the sums of one scan cannot overflow; see ScanScratch.
inline constexpr int kMaxBeams = 16384;

// Beams of a scan may lie this far from its time stamp; further away, beam times are taken for
// broken.
inline constexpr Utime kMaxBeamTimeOffset = std::chrono::seconds(2);

// Applies `options`: sense of rotation, times, range limits, masks and the rule for no returns.
// Beams that say nothing (NaN, negative, below the minimum, masked, no return where that is
// ignored) are left out. InvalidArgument for more than kMaxBeams and for beam times that cannot be
// true.
absl::StatusOr<Scan> PrepareScan(const RangeReadings& readings, const SensorOptions& options,
                                 int channel);

}  // namespace splinemap
