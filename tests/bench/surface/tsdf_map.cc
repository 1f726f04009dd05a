#include "tests/bench/surface/tsdf_map.h"

#include <algorithm>
#include <cmath>

#include "tests/support/sparse_grid.h"

namespace splinemap {
namespace {

constexpr double kMaxWeight = 1e4;  // voxblox

class TsdfMap : public TestedMap {
 public:
  TsdfMap(double cell_m, double truncation_cells)
      : TestedMap(truncation_cells), cell_m_(cell_m), truncation_(truncation_cells) {}

  void AddScan(absl::Span<const PlacedBeam> beams) override {
    for (const PlacedBeam& beam : beams) AddBeam(beam);
  }

  double LogOdds(const Eigen::Vector2d& point_m) override {
    const Eigen::Vector2d cells = point_m / cell_m_;
    const double i = std::floor(cells.x());
    const double j = std::floor(cells.y());
    double sum = 0;
    double weights = 0;
    for (int k = 0; k < 4; ++k) {
      const int di = k & 1;
      const int dj = k >> 1;
      const double weight = (1 - std::abs(cells.x() - i - di)) * (1 - std::abs(cells.y() - j - dj));
      const auto ci = static_cast<int32_t>(i) + di;
      const auto cj = static_cast<int32_t>(j) + dj;
      if (weights_.Get(ci, cj) <= 0) continue;
      sum += weight * distances_.Get(ci, cj);
      weights += weight;
    }
    // In front of all that is known nothing is an obstacle.
    return weights > 0 ? -sum / weights : -truncation_;
  }

  int64_t Bytes() const override {
    return static_cast<int64_t>(weights_.tiles() * Tile::kSize * 2 * sizeof(float));
  }

 private:
  void AddBeam(const PlacedBeam& beam) {
    const Eigen::Vector2d origin = beam.origin_world_m / cell_m_;
    const Eigen::Vector2d& direction = beam.direction_world;
    const double range = beam.range_m / cell_m_;
    const double end = beam.hit ? range + truncation_ : range - truncation_;
    // Each cell that the beam passes once: as many steps as there are borders.
    auto i = static_cast<int32_t>(std::lround(origin.x()));
    auto j = static_cast<int32_t>(std::lround(origin.y()));
    const int32_t step_i = direction.x() < 0 ? -1 : 1;
    const int32_t step_j = direction.y() < 0 ? -1 : 1;
    const auto border = [](int32_t cell, int32_t step, double from, double along) {
      return std::abs(along) < 1e-12 ? 1e12 : (cell + 0.5 * step - from) / along;
    };
    double at = 0;
    while (at < end) {
      const double to_hit = range - (Eigen::Vector2d(i, j) - origin).dot(direction);
      Update(i, j, to_hit);
      const double at_i = border(i, step_i, origin.x(), direction.x());
      const double at_j = border(j, step_j, origin.y(), direction.y());
      at = std::min(at_i, at_j);
      (at_i < at_j ? i : j) += at_i < at_j ? step_i : step_j;
    }
  }

  void Update(int32_t i, int32_t j, double to_hit) {
    const double weight =
        to_hit > -1 ? 1 : std::max(0.0, (truncation_ + to_hit) / (truncation_ - 1));
    if (weight <= 0) return;
    double& distance = distances_.At(i, j);
    double& sum = weights_.At(i, j);
    distance =
        (distance * sum + weight * std::clamp(to_hit, -truncation_, truncation_)) / (sum + weight);
    sum = std::min(sum + weight, kMaxWeight);
  }

  double cell_m_;
  double truncation_;
  SparseGrid distances_;  // in cells
  SparseGrid weights_;
};

}  // namespace

Method TsdfMethod(const std::string& name, double truncation_cells) {
  return {name, [=](double resolution_m) {
            return std::make_unique<TsdfMap>(resolution_m, truncation_cells);
          }};
}

}  // namespace splinemap
