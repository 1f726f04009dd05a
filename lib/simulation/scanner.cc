#include <algorithm>
#include <cmath>
#include <limits>

#include "lib/simulation/simulation.h"

namespace splinemap {
namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

double Cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

double DistanceToWall(const simulation::Wall& wall, const Eigen::Vector2d& origin,
                      const Eigen::Vector2d& direction) {
  const Eigen::Vector2d begin = Eigen::Vector2d(wall.x0_m(), wall.y0_m()) - origin;
  const Eigen::Vector2d along(wall.x1_m() - wall.x0_m(), wall.y1_m() - wall.y0_m());
  const double determinant = Cross(direction, along);
  if (determinant == 0) return kNone;
  const double distance = Cross(begin, along) / determinant;
  const double fraction = Cross(begin, direction) / determinant;
  return distance > 0 && fraction >= 0 && fraction <= 1 ? distance : kNone;
}

double DistanceToPillar(const simulation::Pillar& pillar, const Eigen::Vector2d& origin,
                        const Eigen::Vector2d& direction) {
  const Eigen::Vector2d centre = Eigen::Vector2d(pillar.x_m(), pillar.y_m()) - origin;
  const double along = centre.dot(direction);
  const double across = Cross(direction, centre);
  const double squared = pillar.radius_m() * pillar.radius_m() - across * across;
  if (squared < 0) return kNone;
  const double distance = along - std::sqrt(squared);
  return distance > 0 ? distance : kNone;
}

}  // namespace

std::optional<double> CastRay(const simulation::World& world, double time_s,
                              const Eigen::Vector2d& origin, double bearing_rad) {
  const Eigen::Vector2d direction(std::cos(bearing_rad), std::sin(bearing_rad));
  double nearest = kNone;
  for (const simulation::Wall& wall : world.wall()) {
    if (time_s < wall.from_s() || time_s >= wall.until_s()) continue;
    nearest = std::min(nearest, DistanceToWall(wall, origin, direction));
  }
  for (const simulation::Pillar& pillar : world.pillar()) {
    nearest = std::min(nearest, DistanceToPillar(pillar, origin, direction));
  }
  if (nearest == kNone) return std::nullopt;
  return nearest;
}

std::vector<float> SimulateScan(const simulation::World& world, double time_s, const Pose2& pose,
                                const ScannerOptions& options, std::mt19937_64& random) {
  std::normal_distribution<double> noise(0, options.noise_sigma_m);
  std::vector<float> ranges_m;
  ranges_m.reserve(options.num_beams);
  for (int k = 0; k < options.num_beams; ++k) {
    const double bearing_rad = options.FirstBearing() + k * options.BearingStep();
    const std::optional<double> range_m =
        CastRay(world, time_s, pose.position_m, pose.yaw_rad + bearing_rad);
    const bool returns = range_m && *range_m < options.range_max_m;
    ranges_m.push_back(returns ? static_cast<float>(std::max(*range_m + noise(random), 0.001))
                               : 0.0F);
  }
  return ranges_m;
}

}  // namespace splinemap
