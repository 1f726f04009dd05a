#include "lib/diagnosis/pose_oddities.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "fmt/format.h"

namespace splinemap {

std::string PoseJumps(const TimedPose& from, const TimedPose& to, int64_t jumps) {
  const Eigen::Vector2d& a = from.world_T_robot.position_m;
  const Eigen::Vector2d& b = to.world_T_robot.position_m;
  std::string text = fmt::format(
      "its poses jump from ({:.1f}, {:.1f}) m to ({:.1f}, {:.1f}) m in {:.3f} s, which no robot "
      "does; scans between are left out",
      a.x(), a.y(), b.x(), b.y(), 1e-6 * static_cast<double>((to.utime - from.utime).count()));
  if (jumps >= kManyPoseJumps) {
    text += fmt::format(". They jump {} times: do two localisations publish on it?", jumps);
  }
  return text;
}

std::string CoarsePoses(const TimedPose& pose) {
  const Eigen::Vector2d& p = pose.world_T_robot.position_m;
  return fmt::format(
      "its poses are 32-bit numbers, which at ({:.0f}, {:.0f}) m have steps of {:.2g} m: walls get "
      "that thick. Publish poses in a frame whose origin is near",
      p.x(), p.y(), pose.resolution_m);
}

std::string TiltedPoses(const TimedPose& pose, int64_t tilted, int64_t poses) {
  return fmt::format(
      "{} of its {} poses tilt the robot by more than 10 degrees, one by {:.0f}; their scans are "
      "left out. If the robot is level, is the quaternion in the order w, x, y, z?",
      tilted, poses, std::acos(std::clamp(pose.up_robot.z(), -1.0, 1.0)) * 180 / std::numbers::pi);
}

}  // namespace splinemap
