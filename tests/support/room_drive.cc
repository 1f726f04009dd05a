#include "tests/support/room_drive.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace splinemap {
namespace {

constexpr int kBeams = 45;

Utime Time(double time_s) { return Utime(std::llround((100 + time_s) * 1e6)); }

Pose2 PoseAt(double time_s, double turn) {
  return {{1.2 * std::sin(0.5 * time_s), 0.8 * std::sin(0.8 * time_s)},
          turn * 2.5 * std::sin(0.7 * time_s)};
}

double RangeToWall(const Eigen::Vector2d& from, double bearing_rad) {
  const double c = std::cos(bearing_rad);
  const double s = std::sin(bearing_rad);
  const double to_x = c > 0 ? (3 - from.x()) / c : (-3 - from.x()) / c;
  const double to_y = s > 0 ? (2 - from.y()) / s : (-2 - from.y()) / s;
  return std::min(to_x, to_y);
}

RangeReadings Measure(const RoomDriver& driver, double turn, double time_s) {
  RangeReadings readings;
  readings.utime = Time(time_s + driver.stamp_late_s);
  for (int k = 0; k < kBeams; ++k) {
    const double beam_s = time_s + driver.duration_s * k / (kBeams - 1);
    const Pose2 pose = PoseAt(beam_s, turn);
    const double bearing_rad = k * 2 * std::numbers::pi / kBeams;
    readings.bearings_rad.push_back(static_cast<float>(driver.sign * bearing_rad));
    readings.ranges_m.push_back(static_cast<float>(
        RangeToWall(pose.position_m, pose.yaw_rad + driver.yaw_rad + bearing_rad)));
    if (driver.beam_times) readings.beam_utimes.push_back(Time(beam_s + driver.stamp_late_s));
  }
  return readings;
}

}  // namespace

void DriveInRoom(const RoomDriver& driver, double turn,
                 absl::FunctionRef<void(const TimedPose&)> on_pose,
                 absl::FunctionRef<void(RangeReadings)> on_scan) {
  for (int n = 0; n < 3000; ++n) {
    const double time_s = 0.02 * n;
    on_pose({Time(time_s), PoseAt(time_s, turn)});
    if (n % 10 == 0) on_scan(Measure(driver, turn, time_s));
  }
}

}  // namespace splinemap
