#pragma once

#include <Eigen/Core>

namespace splinemap {

// The 4 x 4 control points around a point, in log-odds: column k belongs to x, row k to y, each as
// in BasisWeights.
using ControlPatch = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

// The surface s at one point and its gradient in the world frame.
struct SurfaceSample {
  Eigen::Vector2d gradient_per_m = Eigen::Vector2d::Zero();  // ds/dx, ds/dy
  double log_odds = 0;                                       // s, equation (17)
  bool known = false;  // the control point nearest to the point was touched by a measurement
};

// Evaluates (4) at the phases t_x, t_y in [0, 1) of one knot cell. Leaves `known` false.
SurfaceSample EvaluatePatch(const ControlPatch& control_points, double t_x, double t_y,
                            double knot_interval_m);

// The second derivatives of (4) there, per square metre.
Eigen::Matrix2d PatchHessian(const ControlPatch& control_points, double t_x, double t_y,
                             double knot_interval_m);

// p = 1 / (1 + exp(-log_odds)), within [0, 1] for every argument that is not NaN.
double Probability(double log_odds);

}  // namespace splinemap
