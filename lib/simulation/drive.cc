#include <algorithm>
#include <cmath>
#include <numbers>

#include "lib/base/status.h"
#include "lib/simulation/simulation.h"

namespace splinemap {

absl::StatusOr<Drive> Drive::Plan(const simulation::World& world) {
  if (world.waypoint_size() == 0) return InvalidArgument("the world has no waypoint to start from");
  const double turn_rate_radps = world.turn_rate_degps() * std::numbers::pi / 180;
  Drive drive;
  drive.last_.position_m = {world.waypoint(0).x_m(), world.waypoint(0).y_m()};
  for (const simulation::Waypoint& waypoint : world.waypoint()) {
    const Eigen::Vector2d way =
        Eigen::Vector2d(waypoint.x_m(), waypoint.y_m()) - drive.last_.position_m;
    if (const double length_m = way.norm(); length_m > 0) {
      const double turn_rad = WrapAngle(std::atan2(way.y(), way.x()) - drive.last_.yaw_rad);
      drive.Append(std::abs(turn_rad) / turn_rate_radps,
                   {drive.last_.position_m, drive.last_.yaw_rad + turn_rad});
      drive.Append(length_m / world.speed_mps(),
                   {drive.last_.position_m + way, drive.last_.yaw_rad});
    }
    drive.Append(waypoint.wait_s(), drive.last_);
  }
  return drive;
}

void Drive::Append(double duration_s, const Pose2& to) {
  if (duration_s > 0) {
    legs_.push_back({duration_s_, duration_s_ + duration_s, last_, to});
    duration_s_ += duration_s;
  }
  last_ = to;
}

Pose2 Drive::PoseAt(double time_s) const {
  if (legs_.empty() || time_s >= duration_s_) return last_;
  const auto leg =
      std::find_if(legs_.begin(), legs_.end(), [&](const Leg& l) { return time_s < l.end_s; });
  const double fraction = (std::max(time_s, 0.0) - leg->begin_s) / (leg->end_s - leg->begin_s);
  return Interpolate(leg->from, leg->to, fraction);
}

}  // namespace splinemap
