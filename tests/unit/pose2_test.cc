#include "splinemap/pose2.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "splinemap/fixed_pose2.h"

namespace splinemap::pose2_test {

constexpr double kPi = std::numbers::pi;

TEST(Pose2Test, CompositionAppliesTheInnerPoseFirst) {
  const Pose2 world_T_robot{{1, 2}, kPi / 2};
  const Pose2 robot_T_sensor{{3, 0}, -kPi / 2};
  const Pose2 world_T_sensor = world_T_robot * robot_T_sensor;
  EXPECT_NEAR(world_T_sensor.position_m.x(), 1, 1e-12);
  EXPECT_NEAR(world_T_sensor.position_m.y(), 5, 1e-12);
  EXPECT_NEAR(world_T_sensor.yaw_rad, 0, 1e-12);
  const Eigen::Vector2d p = world_T_sensor * Eigen::Vector2d(1, 0);
  EXPECT_NEAR(p.x(), 2, 1e-12);
  EXPECT_NEAR(p.y(), 5, 1e-12);
}

TEST(Pose2Test, AnInverseLeadsBack) {
  const Pose2 back = Inverse({{1, -2}, 0.7}) * Pose2{{1, -2}, 0.7};
  EXPECT_LT(back.position_m.norm(), 1e-12);
  EXPECT_EQ(back.yaw_rad, 0);
}

TEST(Pose2Test, InterpolationTurnsTheShorterWay) {
  const Pose2 a{{0, 0}, 0.9 * kPi};
  const Pose2 b{{2, 4}, -0.9 * kPi};
  const Pose2 middle = Interpolate(a, b, 0.5);
  EXPECT_NEAR(std::abs(WrapAngle(middle.yaw_rad)), kPi, 1e-12);
  EXPECT_EQ(middle.position_m, Eigen::Vector2d(1, 2));
  EXPECT_NEAR(
      WrapAngle(Interpolate(a, {{0, 0}, a.yaw_rad + 10 * kPi + 0.2}, 0.5).yaw_rad - a.yaw_rad), 0.1,
      1e-12);
}

TEST(Pose2Test, YawOfAQuaternionIgnoresRollOfTheBody) {
  const double yaw = 0.7;
  EXPECT_NEAR(YawOfQuaternion(std::cos(yaw / 2), 0, 0, std::sin(yaw / 2)), yaw, 1e-12);
  // The same heading, rolled by 0.3 rad about the body's x axis: q_yaw * q_roll.
  const double cy = std::cos(yaw / 2), sy = std::sin(yaw / 2);
  const double cr = std::cos(0.15), sr = std::sin(0.15);
  EXPECT_NEAR(YawOfQuaternion(cy * cr, cy * sr, sy * sr, sy * cr), yaw, 1e-12);
}

TEST(FixedPose2Test, RoundsAndKeepsWhatIsRounded) {
  for (const Pose2& pose :
       {Pose2{{1.23456789, -9876.54321}, 3.1}, Pose2{{0, -1e-7}, -kPi}, Pose2{{1e6, -1e6}, 25}}) {
    const FixedPose2 fixed = FixedPose2::Nearest(pose);
    EXPECT_TRUE(fixed.IsValid());
    EXPECT_LE((fixed.ToPose().position_m - pose.position_m).cwiseAbs().maxCoeff(), 0.5e-6);
    EXPECT_LE(std::abs(WrapAngle(fixed.ToPose().yaw_rad - pose.yaw_rad)), 0.8e-9);
    EXPECT_EQ(FixedPose2::Nearest(fixed.ToPose()), fixed);
  }
  EXPECT_EQ(FixedPose2::Nearest({{0, 0}, kPi}), FixedPose2::Nearest({{0, 0}, -kPi}));
  EXPECT_TRUE(FixedPose2::Nearest({{0, 0}, 2 * kPi}).IsIdentity());
}

TEST(FixedPose2Test, AProductIsTakenApartToTheBit) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> coordinate_m(-1000, 1000);
  std::uniform_real_distribution<double> yaw_rad(-4, 4);
  const auto any = [&] {
    const double x_m = coordinate_m(random);
    const double y_m = coordinate_m(random);
    return FixedPose2::Nearest({{x_m, y_m}, yaw_rad(random)});
  };
  for (int n = 0; n < 1000; ++n) {
    const FixedPose2 a = any();
    const FixedPose2 b = any();
    const FixedPose2 product = a * b;
    EXPECT_EQ(product / b, a);
    const Pose2 exact = a.ToPose() * b.ToPose();
    EXPECT_LT((product.ToPose().position_m - exact.position_m).norm(), 1e-6);
    EXPECT_LT(std::abs(WrapAngle(product.ToPose().yaw_rad - exact.yaw_rad)), 1e-9);
  }
}

}  // namespace splinemap::pose2_test
