#include "splinemap/pose2.h"

#include <cmath>
#include <numbers>

#include "lib/geometry/angle.h"

namespace splinemap {

Pose2 operator*(const Pose2& a_T_b, const Pose2& b_T_c) {
  return {a_T_b * b_T_c.position_m, a_T_b.yaw_rad + b_T_c.yaw_rad};
}

Eigen::Vector2d operator*(const Pose2& a_T_b, const Eigen::Vector2d& p_b) {
  const Eigen::Vector2d x_axis = UnitVector(a_T_b.yaw_rad);
  return a_T_b.position_m + Eigen::Vector2d(x_axis.x() * p_b.x() - x_axis.y() * p_b.y(),
                                            x_axis.y() * p_b.x() + x_axis.x() * p_b.y());
}

Pose2 Inverse(const Pose2& a_T_b) {
  const Pose2 turn{Eigen::Vector2d::Zero(), -a_T_b.yaw_rad};
  return {turn * Eigen::Vector2d(-a_T_b.position_m), turn.yaw_rad};
}

double WrapAngle(double angle_rad) {
  const double wrapped = std::remainder(angle_rad, 2 * std::numbers::pi);
  return wrapped <= -std::numbers::pi ? std::numbers::pi : wrapped;
}

Pose2 Interpolate(const Pose2& a, const Pose2& b, double fraction) {
  return {a.position_m + fraction * (b.position_m - a.position_m),
          a.yaw_rad + fraction * WrapAngle(b.yaw_rad - a.yaw_rad)};
}

double YawOfQuaternion(double w, double x, double y, double z) {
  return AngleOf(w * w + x * x - y * y - z * z, 2 * (w * z + x * y));
}

}  // namespace splinemap
