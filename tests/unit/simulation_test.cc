#include "lib/simulation/simulation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "lib/config/checked_text.h"

namespace splinemap::simulation_test {

constexpr double kPi = std::numbers::pi;

simulation::World World(const std::string& text) {
  simulation::World world;
  EXPECT_TRUE(ParseCheckedText(text, "world", &world).ok());
  return world;
}

TEST(CastRayTest, HitsTheNearestThing) {
  const simulation::World world = World(
      "wall { x0_m: 5 y0_m: -1 x1_m: 5 y1_m: 1 } wall { x0_m: 3 y0_m: 1 x1_m: 3 y1_m: 2 }"
      "pillar { x_m: 0 y_m: 4 radius_m: 0.5 }");
  EXPECT_NEAR(*CastRay(world, 0, {0, 0}, 0), 5, 1e-12);
  EXPECT_NEAR(*CastRay(world, 0, {0, 0}, kPi / 2), 3.5, 1e-12);
  EXPECT_NEAR(*CastRay(world, 0, {0, 1.5}, 0), 3, 1e-12);
  EXPECT_FALSE(CastRay(world, 0, {0, 0}, kPi));
}

TEST(CastRayTest, ADoorIsThereInItsTime) {
  const simulation::World world =
      World("wall { x0_m: 2 y0_m: -1 x1_m: 2 y1_m: 1 from_s: 10 until_s: 20 }");
  EXPECT_FALSE(CastRay(world, 9.9, {0, 0}, 0));
  EXPECT_TRUE(CastRay(world, 10, {0, 0}, 0));
  EXPECT_FALSE(CastRay(world, 20, {0, 0}, 0));
}

TEST(DriveTest, TurnsOnTheSpotAndDrivesStraight) {
  const auto drive = Drive::Plan(World(
      "waypoint { x_m: 0 y_m: 0 } waypoint { x_m: 2 y_m: 0 wait_s: 1 } waypoint { x_m: 2 y_m: 1 }"
      "speed_mps: 0.5 turn_rate_degps: 45"));
  ASSERT_TRUE(drive.ok());
  EXPECT_NEAR(drive->duration_s(), 4 + 1 + 2 + 2, 1e-12);
  EXPECT_NEAR(drive->PoseAt(2).position_m.x(), 1, 1e-12);
  EXPECT_NEAR(drive->PoseAt(6).yaw_rad, kPi / 4, 1e-12);
  EXPECT_EQ(drive->PoseAt(6).position_m, Eigen::Vector2d(2, 0));
  EXPECT_NEAR(drive->PoseAt(100).position_m.y(), 1, 1e-12);
  EXPECT_FALSE(Drive::Plan({}).ok());
}

TEST(SimulateScanTest, IsTheSameForTheSameSeed) {
  const simulation::World world = OfficeFloor();
  std::mt19937_64 a(1), b(1), c(2);
  const Pose2 pose{{3, 6.5}, 0.2};
  const auto scan = SimulateScan(world, 0, pose, {}, a);
  EXPECT_EQ(scan, SimulateScan(world, 0, pose, {}, b));
  EXPECT_NE(scan, SimulateScan(world, 0, pose, {}, c));
  EXPECT_EQ(scan.size(), 360u);
}

TEST(OfficeFloorTest, TheDriveStaysInsideAndTouchesNothing) {
  const simulation::World world = OfficeFloor();
  const auto drive = Drive::Plan(world);
  ASSERT_TRUE(drive.ok());
  for (double t = 0; t < drive->duration_s(); t += 0.25) {
    const Pose2 pose = drive->PoseAt(t);
    for (int k = 0; k < 36; ++k) {
      const auto range = CastRay(world, t, pose.position_m, k * kPi / 18);
      ASSERT_TRUE(range) << "outside at " << t << " s";
      ASSERT_GT(*range, 0.2) << "at " << t << " s, " << pose.position_m.transpose();
    }
  }
}

}  // namespace splinemap::simulation_test
