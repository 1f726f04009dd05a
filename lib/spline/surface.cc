#include "splinemap/surface.h"

#include <cmath>
#include <cstring>

#include "lib/spline/basis.h"
#include "lib/spline/patch_kernel.h"

namespace splinemap {

SurfaceSample EvaluatePatch(const ControlPatch& control_points, double t_x, double t_y,
                            double knot_interval_m) {
  Doubles4 rows[4];
  std::memcpy(rows, control_points.data(), sizeof(rows));
  const Doubles4 sample = EvaluateRows(rows, t_x, t_y, 1, 1 / knot_interval_m);
  return {{sample[0], sample[1]}, sample[2], false};
}

Eigen::Matrix2d PatchHessian(const ControlPatch& control_points, double t_x, double t_y,
                             double knot_interval_m) {
  const auto form = [&](const BasisWeights& by, const BasisWeights& bx) {
    const Eigen::Vector4d row = control_points * Eigen::Vector4d(bx.data());
    return Eigen::Vector4d(by.data()).dot(row) / (knot_interval_m * knot_interval_m);
  };
  const double mixed = form(BasisFirstDerivative(t_y), BasisFirstDerivative(t_x));
  return Eigen::Matrix2d{{form(Basis(t_y), BasisSecondDerivative(t_x)), mixed},
                         {mixed, form(BasisSecondDerivative(t_y), Basis(t_x))}};
}

double Probability(double log_odds) {
  // The exponential of a negative number cannot overflow.
  if (log_odds >= 0) return 1 / (1 + std::exp(-log_odds));
  const double odds = std::exp(log_odds);
  return odds / (1 + odds);
}

}  // namespace splinemap
