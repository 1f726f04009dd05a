#include "lib/spline/surface.h"

#include <cmath>

#include "lib/spline/basis.h"

namespace splinemap {
namespace {

Eigen::Vector4d ToVector(const BasisWeights& weights) {
  return Eigen::Map<const Eigen::Vector4d>(weights.data());
}

}  // namespace

SurfaceSample EvaluatePatch(const ControlPatch& control_points, double t_x, double t_y,
                            double knot_interval_m) {
  const Eigen::Vector4d bx = ToVector(Basis(t_x));
  const Eigen::Vector4d dbx = ToVector(BasisFirstDerivative(t_x)) / knot_interval_m;
  const Eigen::Vector4d ddbx =
      ToVector(BasisSecondDerivative(t_x)) / (knot_interval_m * knot_interval_m);
  const Eigen::Vector4d by = ToVector(Basis(t_y));
  const Eigen::Vector4d dby = ToVector(BasisFirstDerivative(t_y)) / knot_interval_m;
  const Eigen::Vector4d ddby =
      ToVector(BasisSecondDerivative(t_y)) / (knot_interval_m * knot_interval_m);

  // s = by^T C bx, equation (4) with rows for y.
  const Eigen::Vector4d c_bx = control_points * bx;
  const Eigen::Vector4d c_dbx = control_points * dbx;
  const Eigen::Vector4d c_ddbx = control_points * ddbx;
  SurfaceSample sample;
  sample.log_odds = by.dot(c_bx);
  sample.gradient_per_m = {by.dot(c_dbx), dby.dot(c_bx)};
  const double dxy = dby.dot(c_dbx);
  sample.hessian_per_m2 << by.dot(c_ddbx), dxy, dxy, ddby.dot(c_bx);
  return sample;
}

double Probability(double log_odds) {
  // The exponential of a negative number cannot overflow.
  if (log_odds >= 0) return 1 / (1 + std::exp(-log_odds));
  const double odds = std::exp(log_odds);
  return odds / (1 + odds);
}

}  // namespace splinemap
