#pragma once

#include <Eigen/Core>

namespace splinemap {

// A planar rigid transform. `world_T_robot` maps coordinates in the robot's frame to the world's:
// p_world = world_T_robot * p_robot.
struct Pose2 {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  double yaw_rad = 0;  // counter-clockwise from the x axis; any real number
};

// a_T_c = a_T_b * b_T_c. The heading is not wrapped.
Pose2 operator*(const Pose2& a_T_b, const Pose2& b_T_c);
Eigen::Vector2d operator*(const Pose2& a_T_b, const Eigen::Vector2d& p_b);

// b_T_a. The heading is not wrapped.
Pose2 Inverse(const Pose2& a_T_b);

// The same angle in (-pi, pi].
double WrapAngle(double angle_rad);

// From `a` (fraction 0) to `b` (fraction 1): position linear, heading the shorter way round.
Pose2 Interpolate(const Pose2& a, const Pose2& b, double fraction);

// Heading of a quaternion w x y z of any length but 0: the angle of its rotated x axis in the x-y
// plane.
double YawOfQuaternion(double w, double x, double y, double z);

}  // namespace splinemap
