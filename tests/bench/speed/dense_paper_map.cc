#include "tests/bench/speed/dense_paper_map.h"

#include <algorithm>
#include <cmath>

#include "lib/spline/basis.h"

namespace splinemap::bench {
namespace {

constexpr double kKappaHit = 0.9;
constexpr double kKappaFree = -0.3;
constexpr double kSpacing_m = 1.41 * kResolution_m;
constexpr double kLimit = 100;

}  // namespace

DensePaperMap::DensePaperMap(const Eigen::AlignedBox2d& bounds_m)
    : corner_m_(bounds_m.min()),
      width_(static_cast<int>(bounds_m.sizes().x() / kResolution_m)),
      control_points_(width_ * static_cast<size_t>(bounds_m.sizes().y() / kResolution_m)) {}

void DensePaperMap::Insert(const RecordedScan& scan) {
  for (const PlacedBeam& placed : Place(scan)) {
    Measure(placed.origin_world_m + placed.range_m * placed.direction_world, kKappaHit);
    const auto samples = static_cast<int>(placed.range_m / kSpacing_m);
    for (int j = 0; j < samples; ++j) {
      Measure(placed.origin_world_m + j * kSpacing_m * placed.direction_world, kKappaFree);
    }
  }
}

void DensePaperMap::Measure(const Eigen::Vector2d& point_m, double kappa) {
  const double x = (point_m.x() - corner_m_.x()) / kResolution_m;
  const double y = (point_m.y() - corner_m_.y()) / kResolution_m;
  const BasisWeights wx = NormalizedBasis(x - std::floor(x));
  const BasisWeights wy = NormalizedBasis(y - std::floor(y));
  double* row = &control_points_[(static_cast<int>(y) - 1) * width_ + static_cast<int>(x) - 1];
  for (int j = 0; j < 4; ++j, row += width_) {
    for (int i = 0; i < 4; ++i) {
      row[i] = std::clamp(row[i] + kappa * wx[i] * wy[j], -kLimit, kLimit);
    }
  }
}

}  // namespace splinemap::bench
