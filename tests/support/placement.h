#pragma once

#include <numbers>

#include "splinemap/fixed_pose2.h"

namespace splinemap {

// A shift by whole knot intervals.
inline FixedPose2 ShiftBy(double i, double j, double knot_interval_m = 0.05) {
  return FixedPose2::Nearest({{i * knot_interval_m, j * knot_interval_m}, 0});
}

inline FixedPose2 PlacedAt(double x_m, double y_m, double yaw_deg) {
  return FixedPose2::Nearest({{x_m, y_m}, yaw_deg * std::numbers::pi / 180});
}

}  // namespace splinemap
