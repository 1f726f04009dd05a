#include "lib/sensing/pose_buffer.h"

#include <algorithm>
#include <cmath>

namespace splinemap {

bool PoseBuffer::Add(const TimedPose& pose) {
  if (!poses_.empty() && pose.utime < newest() - history_) return false;
  const auto place =
      std::lower_bound(poses_.begin(), poses_.end(), pose.utime,
                       [](const TimedPose& kept, Utime utime) { return kept.utime < utime; });
  if (place != poses_.end() && place->utime == pose.utime) return false;
  poses_.insert(place, pose);
  while (poses_.size() > kMaxPoses || oldest() < newest() - history_) poses_.pop_front();
  return true;
}

std::optional<PoseBuffer::Bracket> PoseBuffer::Find(Utime utime) const {
  const auto after =
      std::lower_bound(poses_.begin(), poses_.end(), utime,
                       [](const TimedPose& kept, Utime t) { return kept.utime < t; });
  if (after == poses_.end()) return std::nullopt;
  if (after->utime == utime) return Bracket{&*after, &*after};
  if (after == poses_.begin()) return std::nullopt;
  return Bracket{&*(after - 1), &*after};
}

bool IsJump(const TimedPose& before, const TimedPose& after) {
  constexpr double kMaxSpeed_m_per_s = 30;
  constexpr double kMaxTurnRate_rad_per_s = 30;
  const double span_s = 1e-6 * static_cast<double>((after.utime - before.utime).count());
  const Pose2& a = before.world_T_robot;
  const Pose2& b = after.world_T_robot;
  const double distance_m = (b.position_m - a.position_m).norm();
  const double turn_rad = std::abs(WrapAngle(b.yaw_rad - a.yaw_rad));
  return (distance_m > 1 && distance_m > kMaxSpeed_m_per_s * span_s) ||
         (turn_rad > M_PI / 2 && turn_rad > kMaxTurnRate_rad_per_s * span_s);
}

bool PoseBuffer::IsInJump(Utime utime) const {
  const auto after =
      std::lower_bound(poses_.begin(), poses_.end(), utime,
                       [](const TimedPose& kept, Utime t) { return kept.utime < t; });
  if (after->utime != utime) return IsJump(*(after - 1), *after);
  const bool from_before = after != poses_.begin() && IsJump(*(after - 1), *after);
  const bool is_last = after + 1 == poses_.end();
  return from_before && (is_last || IsJump(*after, *(after + 1)));
}

namespace {

// Requires two poses.
double FractionOf(const PoseBuffer::Bracket& bracket, Utime utime) {
  const auto span = static_cast<double>((bracket.after->utime - bracket.before->utime).count());
  return static_cast<double>((utime - bracket.before->utime).count()) / span;
}

}  // namespace

Pose2 Interpolate(const PoseBuffer::Bracket& bracket, Utime utime) {
  if (bracket.before == bracket.after) return bracket.before->world_T_robot;
  return Interpolate(bracket.before->world_T_robot, bracket.after->world_T_robot,
                     FractionOf(bracket, utime));
}

Eigen::Vector3d InterpolateUp(const PoseBuffer::Bracket& bracket, Utime utime) {
  const Eigen::Vector3d& before = bracket.before->up_robot;
  const Eigen::Vector3d& after = bracket.after->up_robot;
  if (before == after) return before;
  const Eigen::Vector3d up = before + FractionOf(bracket, utime) * (after - before);
  const double norm = std::sqrt(up.squaredNorm());
  return norm > 0 ? Eigen::Vector3d(up / norm) : before;
}

}  // namespace splinemap
