#include "lib/sensing/pose_buffer.h"

#include <algorithm>

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

Pose2 Interpolate(const PoseBuffer::Bracket& bracket, Utime utime) {
  if (bracket.before == bracket.after) return bracket.before->world_T_robot;
  const auto span = static_cast<double>((bracket.after->utime - bracket.before->utime).count());
  const auto passed = static_cast<double>((utime - bracket.before->utime).count());
  return Interpolate(bracket.before->world_T_robot, bracket.after->world_T_robot, passed / span);
}

}  // namespace splinemap
