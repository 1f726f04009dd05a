#pragma once

#include <cstdint>
#include <string>

#include "lib/sensing/pose_buffer.h"

namespace splinemap {

// Poses whose numbers have longer steps make walls thicker.
inline constexpr double kCoarsePose_m = 0.01;

// Clauses on two poses that no robot can have moved between, the last of `jumps`, and on one whose
// numbers are too coarse.
std::string PoseJumps(const TimedPose& from, const TimedPose& to, int64_t jumps);
std::string CoarsePoses(const TimedPose& pose);

// What is odd about poses: they jump, tilt the robot too much or are too coarse. A clause, or
// nothing.
std::string PoseComplaint(const PoseBuffer& poses);

// Whether a map can be made with them: few of them jump, and few tilt the robot too much.
bool ArePossible(const PoseBuffer& poses);

// Whether the robot stayed within a few centimetres and degrees.
bool StoodStill(const PoseBuffer& poses);

}  // namespace splinemap
