#include "tests/bench/surface/measure.h"

#include <algorithm>
#include <cmath>

namespace splinemap {
namespace {

using Eigen::Vector2d;

constexpr double kReachBefore_m = 0.3;
constexpr double kReachBehind_m = 0.15;
constexpr double kStep_m = 0.004;
constexpr int kHalvings = 8;

class Surface {
 public:
  Surface(TestedMap& map, double level, const Pose2& world_T_scene)
      : map_(map), level_(level), world_T_scene_(world_T_scene) {}

  bool IsObstacle(const Vector2d& scene_m) const {
    return map_.LogOdds(world_T_scene_ * scene_m) > level_;
  }

  // Where the level lies between a point that is no obstacle and one that is.
  Vector2d Crossing(Vector2d free, Vector2d obstacle) const {
    for (int k = 0; k < kHalvings; ++k) {
      const Vector2d middle = (free + obstacle) / 2;
      (IsObstacle(middle) ? obstacle : free) = middle;
    }
    return (free + obstacle) / 2;
  }

  // The first obstacle of the ray within reach of where it should be.
  std::optional<double> Range(const TrueRay& ray) const {
    const double begin_m = std::max(ray.range_m - kReachBefore_m / ray.cos_incidence, 0.05);
    const double end_m = ray.range_m + kReachBehind_m / ray.cos_incidence;
    const auto at = [&](double range_m) -> Vector2d {
      return ray.origin_m + range_m * ray.direction;
    };
    if (IsObstacle(at(begin_m))) return std::nullopt;
    for (double range_m = begin_m; range_m < end_m; range_m += kStep_m) {
      if (IsObstacle(at(range_m + kStep_m))) {
        return (Crossing(at(range_m), at(range_m + kStep_m)) - ray.origin_m).norm();
      }
    }
    return std::nullopt;
  }

  // Points of the level between a box's points that are no obstacles and neighbours that are.
  std::vector<Vector2d> Contour(const Vector2d& least, const Vector2d& most) const {
    const auto columns = static_cast<int>((most.x() - least.x()) / kStep_m) + 1;
    const auto rows = static_cast<int>((most.y() - least.y()) / kStep_m) + 1;
    const auto point = [&](int column, int row) -> Vector2d {
      return least + kStep_m * Vector2d(column, row);
    };
    std::vector<bool> is_obstacle;
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        is_obstacle.push_back(IsObstacle(point(column, row)));
      }
    }
    std::vector<Vector2d> contour;
    const auto add = [&](int column, int row, int next_column, int next_row) {
      const bool first = is_obstacle[row * columns + column];
      if (first == is_obstacle[next_row * columns + next_column]) return;
      const Vector2d a = point(column, row);
      const Vector2d b = point(next_column, next_row);
      contour.push_back(first ? Crossing(b, a) : Crossing(a, b));
    };
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        if (column + 1 < columns) add(column, row, column + 1, row);
        if (row + 1 < rows) add(column, row, column, row + 1);
      }
    }
    return contour;
  }

 private:
  TestedMap& map_;
  double level_;
  Pose2 world_T_scene_;
};

double DistanceTo(const std::vector<Vector2d>& points, const Vector2d& from) {
  double least = 1;
  for (const Vector2d& point : points) least = std::min(least, (point - from).norm());
  return least;
}

// A disc passes between two sets of points if it is no wider than they are apart.
double WidestDisc(const Surface& surface, double width_m) {
  const double half = width_m / 2;
  std::vector<Vector2d> left = surface.Contour({-half - 0.1, -0.15}, {0, 0.3});
  std::vector<Vector2d> right = surface.Contour({0, -0.15}, {half + 0.1, 0.3});
  double least = width_m + 0.2;
  for (const Vector2d& a : left) least = std::min(least, DistanceTo(right, a));
  return least;
}

}  // namespace

Findings Measure(TestedMap& map, double level, const Scene& scene, const Pose2& world_T_scene) {
  const Surface surface(map, level, world_T_scene);
  Findings findings;
  findings.rays = static_cast<int>(scene.rays.size());
  for (const TrueRay& ray : scene.rays) {
    const std::optional<double> range_m = surface.Range(ray);
    if (range_m) {
      findings.ray_errors_m.push_back((*range_m - ray.range_m) * ray.cos_incidence);
    } else {
      ++findings.rays_missed;
    }
  }
  for (const auto& [from, distance_m] : scene.distances) {
    const Vector2d reach = Vector2d::Constant(distance_m + 0.1);
    findings.distance_errors_m.push_back(
        DistanceTo(surface.Contour(from - reach, from + reach), from) - distance_m);
  }
  if (scene.gap_width_m > 0) findings.gap_m = WidestDisc(surface, scene.gap_width_m);
  return findings;
}

}  // namespace splinemap
