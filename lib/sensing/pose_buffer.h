#pragma once

#include <cstddef>
#include <deque>
#include <optional>

#include "splinemap/pose2.h"
#include "splinemap/utime.h"

namespace splinemap {

struct TimedPose {
  Utime utime{0};
  Pose2 world_T_robot;
  // The world's z axis in the robot's frame, a unit vector: how the robot is tilted.
  Eigen::Vector3d up_robot = Eigen::Vector3d::UnitZ();
  double resolution_m = 0;  // of the numbers of the message
};

// Poses of one robot by time, the newest few seconds of them. Thread-compatible.
class PoseBuffer {
 public:
  // Poses older than `history` before the newest are forgotten, and the oldest beyond kMaxPoses.
  explicit PoseBuffer(Utime history) : history_(history) {}

  static constexpr size_t kMaxPoses = 100'000;

  // Keeps the order by time whatever the order of arrival. False where a pose of this time is there
  // already (the first one stays) or the pose is too old to keep.
  bool Add(const TimedPose& pose);

  bool empty() const { return poses_.empty(); }
  Utime oldest() const { return poses_.front().utime; }  // requires !empty()
  Utime newest() const { return poses_.back().utime; }   // requires !empty()
  void Clear() { poses_.clear(); }
  // In the order of time.
  template <typename Visitor>
  void ForEach(Visitor visit) const {
    for (const TimedPose& pose : poses_) visit(pose);
  }

  // The poses at or next before and at or next after `utime`, or nothing where one is missing.
  // Equal where a pose has exactly this time.
  struct Bracket {
    const TimedPose* before = nullptr;
    const TimedPose* after = nullptr;
  };
  std::optional<Bracket> Find(Utime utime) const;

  // Whether the pose at `utime` is none: it is interpolated between poses that no robot can have
  // moved between, or the one of this time is off from those before and after it, or from the one
  // before it while none is after. Requires Find(utime).
  bool IsInJump(Utime utime) const;

 private:
  std::deque<TimedPose> poses_;
  Utime history_;
};

// Whether a robot would have moved at more than 30 m/s, by more than 1 m, or turned at more than 30
// rad/s, by more than a quarter turn.
bool IsJump(const TimedPose& before, const TimedPose& after);

// The pose at `utime` within the bracket, and how the robot was tilted then.
Pose2 Interpolate(const PoseBuffer::Bracket& bracket, Utime utime);
Eigen::Vector3d InterpolateUp(const PoseBuffer::Bracket& bracket, Utime utime);

}  // namespace splinemap
