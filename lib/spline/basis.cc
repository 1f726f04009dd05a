#include "lib/spline/basis.h"

namespace splinemap {

BasisWeights Basis(double t) {
  const double u = 1 - t;
  return {u * u * u / 6, ((3 * t - 6) * t * t + 4) / 6, (((-3 * t + 3) * t + 3) * t + 1) / 6,
          t * t * t / 6};
}

BasisWeights BasisFirstDerivative(double t) {
  const double u = 1 - t;
  return {-u * u / 2, (3 * t - 4) * t / 2, ((-3 * t + 2) * t + 1) / 2, t * t / 2};
}

BasisWeights BasisSecondDerivative(double t) { return {1 - t, 3 * t - 2, -3 * t + 1, t}; }

BasisWeights NormalizedBasis(double t) {
  BasisWeights b = Basis(t);
  const double squared_norm = b[0] * b[0] + b[1] * b[1] + b[2] * b[2] + b[3] * b[3];
  for (double& weight : b) weight /= squared_norm;
  return b;
}

}  // namespace splinemap
