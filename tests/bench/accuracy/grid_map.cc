#include "tests/bench/accuracy/grid_map.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace splinemap {

std::array<double, 4> Nearest(double t) { return {0, t < 0.5 ? 1. : 0., t < 0.5 ? 0. : 1., 0}; }

std::array<double, 4> Bilinear(double t) { return {0, 1 - t, t, 0}; }

std::array<double, 4> Bicubic(double t) {
  const double u = 1 - t;
  return {-0.5 * t * u * u, 1 - t * t * (2.5 - 1.5 * t), 1 - u * u * (2.5 - 1.5 * u),
          -0.5 * u * t * t};
}

GridMap::GridMap(double resolution_m, double limit_log_odds, ReadOut read_out, double kappa_free)
    : TestedMap(limit_log_odds),
      resolution_m_(resolution_m),
      read_out_(read_out),
      kappa_free_(kappa_free) {}

void GridMap::AddScan(absl::Span<const PlacedBeam> beams) {
  for (const PlacedBeam& beam : beams) {
    const Cell end = CellOf(beam.origin_world_m + beam.range_m * beam.direction_world);
    AddFree(CellOf(beam.origin_world_m), end);
    if (beam.hit) Add(end, 0.9);
  }
}

double GridMap::LogOdds(const Eigen::Vector2d& point_m) {
  const Eigen::Vector2d p = point_m / resolution_m_;
  const Cell cell = p.array().floor().cast<int>();
  const std::array<double, 4> wx = read_out_(p.x() - cell.x());
  const std::array<double, 4> wy = read_out_(p.y() - cell.y());
  double value = 0;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const double weight = wx[column] * wy[row];
      if (weight == 0) continue;
      value += weight * cells_.Get(cell.x() - 1 + column, cell.y() - 1 + row);
    }
  }
  return value;
}

int64_t GridMap::Bytes() const { return static_cast<int64_t>(cells_.tiles() * sizeof(Tile)); }

GridMap::Cell GridMap::CellOf(const Eigen::Vector2d& point_m) const {
  return (point_m / resolution_m_).array().round().cast<int>();
}

// Bresenham's line without its last cell.
void GridMap::AddFree(Cell from, Cell to) {
  const int dx = std::abs(to.x() - from.x());
  const int dy = std::abs(to.y() - from.y());
  const int step_x = from.x() < to.x() ? 1 : -1;
  const int step_y = from.y() < to.y() ? 1 : -1;
  int error = dx - dy;
  while (from != to) {
    Add(from, kappa_free_);
    const int twice = 2 * error;
    if (twice > -dy) {
      error -= dy;
      from.x() += step_x;
    }
    if (twice < dx) {
      error += dx;
      from.y() += step_y;
    }
  }
}

void GridMap::Add(Cell cell, double kappa) {
  double& value = cells_.At(cell.x(), cell.y());
  value = std::clamp(value + kappa, -limit_log_odds(), limit_log_odds());  // (16)
}

Method GridMethod(const std::string& name, double limit_log_odds, ReadOut read_out,
                  double kappa_free) {
  return {name, [=](double resolution_m) {
            return std::make_unique<GridMap>(resolution_m, limit_log_odds, read_out, kappa_free);
          }};
}

}  // namespace splinemap
