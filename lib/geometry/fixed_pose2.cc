#include "splinemap/fixed_pose2.h"

#include <cmath>
#include <numbers>

#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

constexpr double kUnitsPerTurn = 4294967296;
constexpr double kTurn_rad = 2 * std::numbers::pi;

}  // namespace

FixedPose2 FixedPose2::Nearest(const Pose2& pose) {
  const double turns = WrapAngle(pose.yaw_rad) / kTurn_rad;
  return {RoundToInt(pose.position_m.x() * kUnitsPerMetre),
          RoundToInt(pose.position_m.y() * kUnitsPerMetre),
          // Half a turn is one to the right.
          static_cast<int32_t>(static_cast<uint32_t>(RoundToInt(turns * kUnitsPerTurn)))};
}

Pose2 FixedPose2::ToPose() const {
  return {{static_cast<double>(x) / kUnitsPerMetre, static_cast<double>(y) / kUnitsPerMetre},
          yaw * (kTurn_rad / kUnitsPerTurn)};
}

bool FixedPose2::IsValid() const {
  return x >= -kMaxUnits && x <= kMaxUnits && y >= -kMaxUnits && y <= kMaxUnits;
}

}  // namespace splinemap
