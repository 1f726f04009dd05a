#pragma once

#include "splinemap/fixed_pose2.h"

namespace splinemap {

// A placement as people type it, with no more digits than give it back to the bit.
struct TypedPlacement {
  double x_m;
  double y_m;
  double yaw_deg;

  explicit TypedPlacement(const FixedPose2& placement);
};

}  // namespace splinemap
