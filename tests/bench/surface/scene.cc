#include "tests/bench/surface/scene.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <optional>

namespace splinemap {
namespace {

using Eigen::Vector2d;

constexpr double kRad = std::numbers::pi / 180;

void AddWall(simulation::World& world, const Vector2d& a, const Vector2d& b) {
  simulation::Wall& wall = *world.add_wall();
  wall.set_x0_m(a.x());
  wall.set_y0_m(a.y());
  wall.set_x1_m(b.x());
  wall.set_y1_m(b.y());
}

void AddBox(simulation::World& world, const Vector2d& least, const Vector2d& most) {
  const Vector2d corners[] = {least, {most.x(), least.y()}, most, {least.x(), most.y()}};
  for (int k = 0; k < 4; ++k) AddWall(world, corners[k], corners[(k + 1) % 4]);
}

// Asks for the range of the ray from `from` towards `to`.
void AddRay(Scene& scene, const Vector2d& from, const Vector2d& to, double cos_incidence) {
  const Vector2d direction = (to - from).normalized();
  const std::optional<double> range_m =
      CastRay(scene.world, 0, from, std::atan2(direction.y(), direction.x()));
  if (range_m) scene.rays.push_back({from, direction, *range_m, cos_incidence});
}

Vector2d PointOn(const std::vector<Vector2d>& way_m, double share) {
  if (way_m.size() == 1) return way_m.front();
  const double pieces = static_cast<double>(way_m.size() - 1);
  const auto piece = std::min(static_cast<size_t>(share * pieces), way_m.size() - 2);
  const double t = share * pieces - static_cast<double>(piece);
  return way_m[piece] + t * (way_m[piece + 1] - way_m[piece]);
}

}  // namespace

std::vector<std::vector<PlacedBeam>> Scans(const Scene& scene, const Pose2& world_T_scene,
                                           const Sensing& sensing, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0, 1);
  std::uniform_real_distribution<double> uniform(0, 1);
  const Eigen::Rotation2D<double> turn(world_T_scene.yaw_rad);
  const double step_rad = 2 * std::numbers::pi / sensing.beams;
  std::vector<std::vector<PlacedBeam>> scans;
  for (int n = 0; n < sensing.scans; ++n) {
    const Vector2d at_m = PointOn(scene.way_m, (n + 0.5) / sensing.scans);
    const double yaw_rad = 2 * std::numbers::pi * uniform(random);
    std::vector<double> ranges_m;
    for (int k = 0; k < sensing.beams; ++k) {
      ranges_m.push_back(CastRay(scene.world, 0, at_m, yaw_rad + k * step_rad).value_or(0));
    }
    std::vector<PlacedBeam> beams;
    for (int k = 0; k < sensing.beams; ++k) {
      double range_m = ranges_m[k];
      if (range_m <= 0 || range_m > sensing.range_max_m) continue;
      const double next_m = ranges_m[(k + 1) % sensing.beams];
      if (next_m > range_m + 0.1 && uniform(random) < sensing.mixed_share) {
        range_m += uniform(random) * std::min(next_m - range_m, 0.5);
      }
      range_m += sensing.noise_sigma_m * noise(random);
      const double bearing_rad = yaw_rad + k * step_rad;
      beams.push_back({world_T_scene * at_m,
                       turn * Vector2d(std::cos(bearing_rad), std::sin(bearing_rad)),
                       std::max(range_m, 0.01), true});
    }
    scans.push_back(std::move(beams));
  }
  return scans;
}

// The sensor moves 0.4 m along the wall y = 0, which is asked for where it is seen so.
Scene WallScene(double distance_m, double incidence_deg) {
  Scene scene;
  scene.name = fmt::format("wall {:g} m {:g} deg", distance_m, incidence_deg);
  AddWall(scene.world, {-50, 0}, {50, 0});
  const double side_m = distance_m * std::tan(incidence_deg * kRad);
  scene.way_m = {{-side_m - 0.2, -distance_m}, {-side_m + 0.2, -distance_m}};
  const double cos_incidence = std::cos(incidence_deg * kRad);
  for (int k = 0; k < 21; ++k) {
    const double x = -0.2 + 0.02 * k;
    AddRay(scene, {x - side_m, -distance_m}, {x, 0}, cos_incidence);
  }
  for (int k = 0; k < 5; ++k) scene.distances.push_back({{-0.1 + 0.05 * k, -0.4}, 0.4});
  return scene;
}

Scene ThinWallScene(double thickness_m, bool from_both_sides) {
  Scene scene;
  scene.name = fmt::format("thin wall {:g} cm {}", 100 * thickness_m,
                           from_both_sides ? "two sides" : "one side");
  AddBox(scene.world, {-1.5, 0}, {1.5, thickness_m});
  scene.way_m = {{-0.5, -1.5}, {0.5, -1.5}};
  if (from_both_sides) {
    scene.way_m = {{-0.5, -1.5}, {0.5, -1.5}, {2.5, 0}, {0.5, 1.5}, {-0.5, 1.5}};
  }
  for (int k = 0; k < 21; ++k) {
    const double x = -0.2 + 0.02 * k;
    AddRay(scene, {x, -1.0}, {x, 0}, 1);
    if (from_both_sides) AddRay(scene, {x, 1.0}, {x, 0}, 1);
  }
  return scene;
}

// Faces x = 0 for y > 0 and y = 0 for x > 0. Convex: the thing is where both are positive, else
// everywhere but there.
Scene CornerScene(bool convex) {
  Scene scene;
  scene.name = convex ? "corner convex" : "corner concave";
  AddWall(scene.world, {0, 0}, {0, 20});
  AddWall(scene.world, {0, 0}, {20, 0});
  if (convex) {
    scene.way_m = {{1.0, -1.5}, {-1.5, -1.5}, {-1.5, 1.0}};
  } else {
    scene.way_m = {{1.0, 2.0}, {2.0, 2.0}, {2.0, 1.0}};
  }
  const double side = convex ? -1 : 1;
  for (int k = 0; k < 8; ++k) {
    const double along = 0.02 + 0.03 * k;
    AddRay(scene, {along, side}, {along, 0}, 1);
    AddRay(scene, {side, along}, {0, along}, 1);
  }
  if (convex) {
    scene.distances.push_back({{-0.3, -0.3}, 0.3 * std::numbers::sqrt2});
  } else {
    scene.distances.push_back({{0.3, 0.3}, 0.3});
  }
  return scene;
}

// The sensor drives through.
Scene DoorScene(double width_m, double thickness_m) {
  Scene scene;
  scene.name = fmt::format("door {:.2f} m in {:g} cm", width_m, 100 * thickness_m);
  scene.gap_width_m = width_m;
  AddBox(scene.world, {width_m / 2, 0}, {4, thickness_m});
  AddBox(scene.world, {-4, 0}, {-width_m / 2, thickness_m});
  AddBox(scene.world, {-4, -4}, {4, 4});
  scene.way_m = {{0.1, -2.5}, {0.0, 0.0}, {-0.1, 2.5}};
  return scene;
}

// A pole at the origin, in a room; the sensor passes 1 m beside it or drives around it.
Scene PoleScene(double diameter_m, bool from_all_sides) {
  Scene scene;
  scene.name =
      fmt::format("pole {:g} cm {}", 100 * diameter_m, from_all_sides ? "all sides" : "one side");
  scene.pole_diameter_m = diameter_m;
  AddBox(scene.world, {-4, -4}, {4, 4});
  simulation::Pillar& pillar = *scene.world.add_pillar();
  pillar.set_x_m(0);
  pillar.set_y_m(0);
  pillar.set_radius_m(diameter_m / 2);
  if (from_all_sides) {
    for (int k = 0; k <= 16; ++k) {
      const double turned = k * std::numbers::pi / 8;
      scene.way_m.push_back(1.5 * Vector2d(std::cos(turned), std::sin(turned)));
    }
  } else {
    scene.way_m = {{-2, -1.5}, {2, -1.5}};
  }
  for (int k = 0; k < 9; ++k) {
    const double turned =
        from_all_sides ? k * 2 * std::numbers::pi / 9 : (-135 + 90.0 * k / 8) * kRad;
    const Vector2d from = 1.2 * Vector2d(std::cos(turned), std::sin(turned));
    AddRay(scene, from, {0, 0}, 1);
    scene.distances.push_back({from * (0.4 / 1.2), 0.4 - diameter_m / 2});
  }
  return scene;
}

}  // namespace splinemap
