#include "tests/support/paper_map.h"

#include <algorithm>
#include <cmath>

#include "lib/spline/basis.h"

namespace splinemap {
namespace {

// Calls function(i, j, weight) for the 16 control points around p.
template <typename Function>
void ForPatch(const Eigen::Vector2d& p_m, double knot_interval_m, BasisWeights (*weights)(double),
              Function function) {
  const KnotPosition x = *LocateKnot(p_m.x(), knot_interval_m);
  const KnotPosition y = *LocateKnot(p_m.y(), knot_interval_m);
  const BasisWeights wx = weights(x.t);
  const BasisWeights wy = weights(y.t);
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      function(x.index - 1 + column, y.index - 1 + row, wx[column] * wy[row]);
    }
  }
}

}  // namespace

void PaperMap::Add(const PlacedBeam& beam) {
  const double spacing_m = 1.41 * knot_interval_m_;
  if (beam.hit) Measure(beam.origin_world_m + beam.range_m * beam.direction_world, 0.9);  // (8)
  for (int j = 0; j < std::floor(beam.range_m / spacing_m); ++j) {                        // (9)
    Measure(beam.origin_world_m + j * spacing_m * beam.direction_world, -0.3);
  }
}

double PaperMap::Evaluate(double x_m, double y_m) const {
  double s = 0;
  ForPatch({x_m, y_m}, knot_interval_m_, &Basis,
           [&](int32_t i, int32_t j, double weight) { s += control_points_.Get(i, j) * weight; });
  return s;
}

void PaperMap::Measure(const Eigen::Vector2d& point_m, double kappa) {
  ForPatch(point_m, knot_interval_m_, &NormalizedBasis, [&](int32_t i, int32_t j, double weight) {
    double& c = control_points_.At(i, j);
    c = std::clamp(c + kappa * weight, -kLimitLogOdds, kLimitLogOdds);  // (36)
  });
}

}  // namespace splinemap
