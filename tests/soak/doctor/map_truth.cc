#include "tests/soak/doctor/map_truth.h"

#include <absl/container/flat_hash_set.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "lib/render/pixel_grid.h"

namespace splinemap::doctor_law {
namespace {

constexpr double kCell_m = 0.05;
// Of the centre of a cell that lies wholly farther than 15 cm.
constexpr double kOff_m = 0.15 + kCell_m / 2;
constexpr int kFoundCells = 2;

double DistanceToWalls(const simulation::World& world, const Eigen::Vector2d& point) {
  double nearest_m = std::numeric_limits<double>::infinity();
  for (const simulation::Wall& wall : world.wall()) {
    const Eigen::Vector2d begin(wall.x0_m(), wall.y0_m());
    const Eigen::Vector2d along = Eigen::Vector2d(wall.x1_m(), wall.y1_m()) - begin;
    const double share = std::clamp((point - begin).dot(along) / along.squaredNorm(), 0.0, 1.0);
    nearest_m = std::min(nearest_m, (point - begin - share * along).norm());
  }
  for (const simulation::Pillar& pillar : world.pillar()) {
    const double to_centre_m = (point - Eigen::Vector2d(pillar.x_m(), pillar.y_m())).norm();
    nearest_m = std::min(nearest_m, std::abs(to_centre_m - pillar.radius_m()));
  }
  return nearest_m;
}

std::pair<int, int> CellOf(const Eigen::Vector2d& point) {
  return {static_cast<int>(std::lround(point.x() / kCell_m)),
          static_cast<int>(std::lround(point.y() / kCell_m))};
}

}  // namespace

Quality Compare(const MapView& map, const simulation::World& world) {
  const auto grid = GridOfRegion(map, std::nullopt, kCell_m);
  if (!grid.ok()) return {};  // an empty map shows nothing
  absl::flat_hash_set<std::pair<int, int>> occupied;
  double off = 0;
  for (int row = 0; row < grid->height; ++row) {
    for (int column = 0; column < grid->width; ++column) {
      const Eigen::Vector2d centre(grid->CentreX(column), grid->CentreY(row));
      if (map.Evaluate(centre.x(), centre.y()).log_odds <= 0) continue;
      occupied.insert(CellOf(centre));
      off += DistanceToWalls(world, centre) > kOff_m ? 1 : 0;
    }
  }
  const auto is_found = [&](const Eigen::Vector2d& point) {
    const auto [x, y] = CellOf(point);
    for (int dx = -kFoundCells; dx <= kFoundCells; ++dx) {
      for (int dy = -kFoundCells; dy <= kFoundCells; ++dy) {
        if (occupied.contains({x + dx, y + dy})) return true;
      }
    }
    return false;
  };
  double points = 0;
  double found = 0;
  for (const simulation::Wall& wall : world.wall()) {
    const Eigen::Vector2d begin(wall.x0_m(), wall.y0_m());
    const Eigen::Vector2d along = Eigen::Vector2d(wall.x1_m(), wall.y1_m()) - begin;
    const double steps = std::ceil(along.norm() / kCell_m);
    for (double k = 0; k <= steps; ++k, ++points) found += is_found(begin + k / steps * along);
  }
  if (occupied.empty()) return {};
  return {.off = off / static_cast<double>(occupied.size()), .found = found / points};
}

}  // namespace splinemap::doctor_law
