#include "lib/wire/trajectory_parts.h"

#include <utility>

#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/base/status.h"
#include "lib/wire/decode.h"

namespace splinemap {

std::string TrajectorySigning(const std::string& channel_prefix, uint64_t daemon_nonce) {
  return fmt::format("{}_TRAJECTORY {:016x}", channel_prefix, daemon_nonce);
}

absl::StatusOr<std::optional<Trajectory>> TrajectoryParts::Add(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(const trajectory_t part, Decode<trajectory_t>(message));
  if (!part.robot.empty() && part.robot != robot_) return std::nullopt;
  if (part.num_parts < 1 || part.num_parts > kMaxParts || part.part < 0 ||
      part.part >= part.num_parts) {
    return InvalidArgument("part {} of {} of a trajectory; up to {} parts can be", part.part,
                           part.num_parts, kMaxParts);
  }
  if (part.utime != utime_ || part.num_parts != num_parts_) {
    utime_ = part.utime;
    num_parts_ = part.num_parts;
    num_poses_ = 0;
    parts_.clear();
  }
  std::vector<TrajectoryPose> poses;
  for (int k = 0; k < part.num_poses; ++k) {
    poses.push_back({Utime(part.pose_utime[k]), {{part.x_m[k], part.y_m[k]}, part.yaw_rad[k]}});
  }
  if (parts_.contains(part.part)) return std::nullopt;  // sent again
  if (num_poses_ + poses.size() > kMaxPoses)
    return InvalidArgument("a trajectory of more than {} poses", kMaxPoses);
  num_poses_ += poses.size();
  parts_[part.part] = std::move(poses);
  if (static_cast<int>(parts_.size()) < num_parts_) return std::nullopt;
  Trajectory whole;
  whole.until = Utime(utime_);
  for (const auto& [index, of_part] : parts_) {
    whole.poses.insert(whole.poses.end(), of_part.begin(), of_part.end());
  }
  parts_.clear();
  utime_ = -1;  // whole
  return whole;
}

}  // namespace splinemap
