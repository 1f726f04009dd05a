#include "tests/bench/accuracy/corridor.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace splinemap {
namespace {

using Eigen::Vector2d;

struct Wall {
  Vector2d from_m;
  Vector2d to_m;
};

const Wall kDoor{{-0.45, 1}, {0.45, 1}};

const std::vector<Wall> kWalls = {
    {{-6, -1}, {6, -1}}, {{-6, -1}, {-6, 1}},    {{6, -1}, {6, 1}},     {{-6, 1}, {-0.45, 1}},
    {{0.45, 1}, {6, 1}}, {{-2.5, 1}, {-2.5, 5}}, {{-2.5, 5}, {2.5, 5}}, {{2.5, 1}, {2.5, 5}},
};

// From the robot to the wall; infinity where it is not hit.
double RangeTo(const Wall& wall, const Vector2d& robot_m, const Vector2d& direction) {
  // robot + r direction = from + share (to - from)
  Eigen::Matrix2d a;
  a << direction, wall.from_m - wall.to_m;
  const Vector2d range_and_share = a.inverse() * (wall.from_m - robot_m);
  const bool hit =
      range_and_share(0) > 0 && range_and_share(1) >= 0 && range_and_share(1) <= 1;  // not if NaN
  return hit ? range_and_share(0) : std::numeric_limits<double>::infinity();
}

}  // namespace

Corridor::Corridor(const Vector2d& robot_m) {
  for (int k = 0; k < 360; ++k) {
    const double bearing_rad = k * std::numbers::pi / 180;
    const Vector2d direction(std::cos(bearing_rad), std::sin(bearing_rad));
    double range_m = std::numeric_limits<double>::infinity();
    for (const Wall& wall : kWalls) {
      range_m = std::min(range_m, RangeTo(wall, robot_m, direction));
    }
    const double door_m = RangeTo(kDoor, robot_m, direction);
    open_.push_back({robot_m, direction, range_m, true});
    closed_.push_back({robot_m, direction, std::min(range_m, door_m), true});
    if (door_m < range_m) door_points_m_.push_back(robot_m + door_m * direction);
  }
}

std::vector<PlacedBeam> Corridor::Scan(bool closed, std::mt19937_64& random) const {
  std::normal_distribution<double> noise_m(0, 0.01);
  std::vector<PlacedBeam> beams = closed ? closed_ : open_;
  for (PlacedBeam& beam : beams) beam.range_m += noise_m(random);
  return beams;
}

}  // namespace splinemap
