#pragma once

#include <compare>
#include <cstdint>

#include "splinemap/pose2.h"

namespace splinemap {

// A planar rigid transform in whole numbers, so that it is the same wherever it was stored or sent:
// to 1 um and 1.5e-9 rad.
struct FixedPose2 {
  static constexpr double kUnitsPerMetre = 1 << 20;
  static constexpr int64_t kMaxUnits = int64_t{1} << 45;  // each way, 33,554 km

  int64_t x = 0;
  int64_t y = 0;
  int32_t yaw = 0;  // in 2^-32 turns, counter-clockwise

  auto operator<=>(const FixedPose2&) const = default;

  // Whether numbers are finite, and positions within kMaxUnits.
  static bool IsInRange(const Pose2& pose);
  // The nearest; requires finite numbers.
  static FixedPose2 Nearest(const Pose2& pose);
  // Its heading is in [-pi, pi).
  Pose2 ToPose() const;
  // In whole numbers: (a * b) / b is a, to the bit.
  friend FixedPose2 operator*(const FixedPose2& a, const FixedPose2& b);
  friend FixedPose2 operator/(const FixedPose2& product, const FixedPose2& b);
  bool IsIdentity() const { return *this == FixedPose2(); }
  // Whether a file or a message may say so.
  bool IsValid() const;
};

}  // namespace splinemap
