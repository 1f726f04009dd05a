#include "lib/geometry/angle.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "lib/geometry/angle_kernel.h"

namespace splinemap::angle_test {

TEST(AngleTest, UnitVectorsAreThoseOfTheCLibrary) {
  std::mt19937_64 random(1);
  for (const double reach_rad : {1.0, 10.0, 1e5, 1e9}) {
    std::uniform_real_distribution<double> uniform(-reach_rad, reach_rad);
    for (int n = 0; n < 20'000; ++n) {
      const double angle_rad = uniform(random);
      const Eigen::Vector2d unit = UnitVector(angle_rad);
      const double tolerance = std::max(4e-16, reach_rad * 2e-16);
      EXPECT_NEAR(unit.x(), std::cos(angle_rad), tolerance) << angle_rad;
      EXPECT_NEAR(unit.y(), std::sin(angle_rad), tolerance) << angle_rad;
    }
  }
}

TEST(AngleTest, ManyAnglesGiveTheBytesOfEach) {
  std::mt19937_64 random(3);
  for (const double reach_rad : {1e-3, 10.0, 9e5, 1e7}) {
    std::uniform_real_distribution<double> uniform(-reach_rad, reach_rad);
    for (const size_t count : {0, 1, 4, 7, 1000}) {
      std::vector<double> angles_rad(count);
      for (double& angle_rad : angles_rad) {
        angle_rad = random() % 8 == 0 ? M_PI / 4 * static_cast<double>(random() % 32) - 4 * M_PI
                                      : uniform(random);
      }
      std::vector<Eigen::Vector2d> units(count);
      UnitVectors(angles_rad, absl::MakeSpan(units));
      for (size_t n = 0; n < count; ++n) {
        ASSERT_EQ(units[n], UnitVector(angles_rad[n])) << angles_rad[n];
      }
    }
  }
}

TEST(AngleTest, KernelsGiveTheBytesOfEach) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> uniform(-kMaxReduced_rad, kMaxReduced_rad);
  std::vector<double> angles_rad(4000);
  for (double& angle_rad : angles_rad) {
    angle_rad = random() % 8 == 0 ? M_PI / 4 * static_cast<double>(random() % 32) - 4 * M_PI
                                  : uniform(random);
  }
  for (const AngleKernel& kernel : AngleKernels()) {
    std::vector<Eigen::Vector2d> units(angles_rad.size());
    kernel.set_units(angles_rad.data(), angles_rad.size(), units.front().data());
    for (size_t n = 0; n < angles_rad.size(); ++n) {
      ASSERT_EQ(units[n], UnitVector(angles_rad[n])) << kernel.name << " " << angles_rad[n];
    }
  }
}

TEST(AngleTest, UnitVectorsOfQuarterTurnsAreExactOnTheirOwnSide) {
  EXPECT_EQ(UnitVector(0), Eigen::Vector2d(1, 0));
  EXPECT_EQ(UnitVector(M_PI / 2).y(), 1);
  EXPECT_EQ(UnitVector(M_PI).x(), -1);
  EXPECT_EQ(UnitVector(-M_PI / 2).y(), -1);
}

TEST(AngleTest, AnglesOfVectorsAreThoseOfTheCLibrary) {
  std::mt19937_64 random(2);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int n = 0; n < 50'000; ++n) {
    const double scale = std::pow(10, 300 * uniform(random));
    const double x = scale * uniform(random);
    const double y = scale * uniform(random);
    EXPECT_NEAR(AngleOf(x, y), std::atan2(y, x), 1e-15) << x << ", " << y;
  }
}

TEST(AngleTest, AnglesOnTheAxes) {
  EXPECT_EQ(AngleOf(1, 0), 0);
  EXPECT_NEAR(AngleOf(0, 2), M_PI / 2, 1e-15);
  EXPECT_NEAR(AngleOf(-1, 0), M_PI, 1e-15);
  EXPECT_NEAR(AngleOf(-1, -0.0), -M_PI, 1e-15);
  EXPECT_NEAR(AngleOf(0, -3), -M_PI / 2, 1e-15);
  EXPECT_EQ(AngleOf(0, 0), 0);
}

TEST(AngleTest, RoundsToTheNearest) {
  EXPECT_EQ(FloorToInt(-0.5), -1);
  EXPECT_EQ(FloorToInt(-2.0), -2);
  EXPECT_EQ(FloorToInt(2.9), 2);
  EXPECT_EQ(RoundToInt(2.5), 3);
  EXPECT_EQ(RoundToInt(-2.5), -2);
  EXPECT_EQ(RoundToInt(-2.6), -3);
}

}  // namespace splinemap::angle_test
