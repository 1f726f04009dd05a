#pragma once

#include <cstdint>
#include <string>

#include "lib/sensing/pose_buffer.h"

namespace splinemap {

// Poses whose numbers have longer steps make walls thicker.
inline constexpr double kCoarsePose_m = 0.01;
// So many jumps are no slip of the localisation.
inline constexpr int64_t kManyPoseJumps = 10;

// What to say of poses that no robot can have moved between, the last two and how often in all; and
// of those whose numbers are too coarse. Clauses.
std::string PoseJumps(const TimedPose& from, const TimedPose& to, int64_t jumps);
std::string CoarsePoses(const TimedPose& pose);
// Of poses that tilt the robot too much, `tilted` of `poses`.
std::string TiltedPoses(const TimedPose& pose, int64_t tilted, int64_t poses);

}  // namespace splinemap
