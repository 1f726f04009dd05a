#include "splinemap/fixed_pose2.h"

#include <algorithm>
#include <numbers>

#include "lib/geometry/angle.h"
#include "lib/geometry/binary_angle.h"

namespace splinemap {
namespace {

constexpr double kUnitsPerTurn = 4294967296;
constexpr double kTurn_rad = 2 * std::numbers::pi;

int64_t UnitsOf(double coordinate_m) {
  constexpr auto kMax = static_cast<double>(FixedPose2::kMaxUnits);
  return RoundToInt(std::clamp(coordinate_m * FixedPose2::kUnitsPerMetre, -kMax, kMax));
}

// The position of b, turned.
FixedPose2 Turned(const FixedPose2& b, int32_t yaw) {
  FixedPose2 turn;
  turn.yaw = yaw;
  return FixedPose2::Nearest({turn.ToPose() * b.ToPose().position_m, 0});
}

}  // namespace

FixedPose2 operator*(const FixedPose2& a, const FixedPose2& b) {
  const FixedPose2 turned = Turned(b, a.yaw);
  return {a.x + turned.x, a.y + turned.y, WrappedSum(a.yaw, b.yaw)};
}

FixedPose2 operator/(const FixedPose2& product, const FixedPose2& b) {
  const int32_t yaw = WrappedStep(b.yaw, product.yaw);
  const FixedPose2 turned = Turned(b, yaw);
  return {product.x - turned.x, product.y - turned.y, yaw};
}

bool FixedPose2::IsInRange(const Pose2& pose) {
  // Also false for NaN.
  return pose.position_m.cwiseAbs().maxCoeff<Eigen::PropagateNaN>() <= kMaxUnits / kUnitsPerMetre &&
         std::isfinite(pose.yaw_rad);
}

FixedPose2 FixedPose2::Nearest(const Pose2& pose) {
  const double turns = WrapAngle(pose.yaw_rad) / kTurn_rad;
  return {UnitsOf(pose.position_m.x()), UnitsOf(pose.position_m.y()),
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
