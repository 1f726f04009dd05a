#include "lib/diagnosis/pose_oddities.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "fmt/format.h"
#include "splinemap/scan.h"

namespace splinemap {
namespace {

// So many jumps are no slip of the localisation.
constexpr int64_t kManyJumps = 10;

struct Jumps {
  int64_t count = 0;
  TimedPose from;  // the last one
  TimedPose to;
};
Jumps JumpsOf(const PoseBuffer& poses) {
  Jumps jumps;
  std::optional<TimedPose> last;
  poses.ForEach([&](const TimedPose& pose) {
    if (last && IsJump(*last, pose)) jumps = {jumps.count + 1, *last, pose};
    last = pose;
  });
  return jumps;
}

struct Tilts {
  int64_t poses = 0;
  int64_t tilted = 0;  // too much
  TimedPose last;
};
Tilts TiltsOf(const PoseBuffer& poses) {
  Tilts tilts;
  poses.ForEach([&](const TimedPose& pose) {
    ++tilts.poses;
    if (!IsTiltedTooMuch(pose.up_robot)) return;
    ++tilts.tilted;
    tilts.last = pose;
  });
  return tilts;
}

std::string TiltedPoses(const TimedPose& pose, int64_t tilted, int64_t poses) {
  return fmt::format(
      "{} of its {} poses tilt the robot by more than 10 degrees, one by {:.0f}; their scans are "
      "left out. If the robot is level, is the quaternion in the order w, x, y, z?",
      tilted, poses, std::acos(std::clamp(pose.up_robot.z(), -1.0, 1.0)) * 180 / std::numbers::pi);
}

}  // namespace

std::string PoseJumps(const TimedPose& from, const TimedPose& to, int64_t jumps) {
  const Eigen::Vector2d& a = from.world_T_robot.position_m;
  const Eigen::Vector2d& b = to.world_T_robot.position_m;
  std::string text = fmt::format(
      "its poses jump from ({:.1f}, {:.1f}) m to ({:.1f}, {:.1f}) m in {:.3f} s, which no robot "
      "does; scans between are left out",
      a.x(), a.y(), b.x(), b.y(), 1e-6 * static_cast<double>((to.utime - from.utime).count()));
  if (jumps >= kManyJumps) {
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

std::string PoseComplaint(const PoseBuffer& poses) {
  const Jumps jumps = JumpsOf(poses);
  if (jumps.count > 0) return PoseJumps(jumps.from, jumps.to, jumps.count);
  if (const Tilts tilts = TiltsOf(poses); tilts.tilted > 0) {
    return TiltedPoses(tilts.last, tilts.tilted, tilts.poses);
  }
  std::optional<TimedPose> coarse;
  poses.ForEach([&](const TimedPose& pose) {
    if (pose.resolution_m > kCoarsePose_m) coarse = pose;
  });
  return coarse ? CoarsePoses(*coarse) : "";
}

bool ArePossible(const PoseBuffer& poses) {
  const Tilts tilts = TiltsOf(poses);
  return JumpsOf(poses).count * 10 <= tilts.poses && tilts.tilted * 2 <= tilts.poses;
}

bool StoodStill(const PoseBuffer& poses) {
  constexpr double kStill_m = 0.1;
  constexpr double kStill_rad = 0.1;
  std::optional<Pose2> first;
  bool still = true;
  poses.ForEach([&](const TimedPose& pose) {
    if (!first) first = pose.world_T_robot;
    still &= (pose.world_T_robot.position_m - first->position_m).norm() < kStill_m &&
             std::abs(WrapAngle(pose.world_T_robot.yaw_rad - first->yaw_rad)) < kStill_rad;
  });
  return still;
}

}  // namespace splinemap
