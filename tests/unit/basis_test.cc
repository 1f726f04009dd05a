#include "lib/spline/basis.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numeric>

namespace splinemap::basis_test {

// De Boor's recursion (1), (2) on the knots 0, 1, .. of the spline with support [0, 4).
double DeBoor(int i, int degree, double tau) {
  if (degree == 0) return tau >= i && tau < i + 1 ? 1 : 0;
  return (tau - i) / degree * DeBoor(i, degree - 1, tau) +
         (i + degree + 1 - tau) / degree * DeBoor(i + 1, degree - 1, tau);
}

// Control point i - 1 + k has its spline centred at i - 1 + k: at phase t that is 3 - k + t from
// the beginning of the support.
double Reference(int k, double t) { return DeBoor(0, 3, 3 - k + t); }

TEST(BasisTest, EqualsDeBoorsRecursion) {
  for (double t = 0; t < 1; t += 1.0 / 64) {
    for (int k = 0; k < 4; ++k) EXPECT_NEAR(Basis(t)[k], Reference(k, t), 1e-15) << k << " " << t;
  }
}

TEST(BasisTest, SumsToOneAndDerivativesToZero) {
  for (double t = 0; t < 1; t += 1.0 / 64) {
    const auto sum = [](const BasisWeights& w) { return w[0] + w[1] + w[2] + w[3]; };
    EXPECT_NEAR(sum(Basis(t)), 1, 1e-15);
    EXPECT_NEAR(sum(BasisFirstDerivative(t)), 0, 1e-15);
    EXPECT_NEAR(sum(BasisSecondDerivative(t)), 0, 1e-15);
  }
}

TEST(BasisTest, DerivativesAreThoseOfTheBasis) {
  constexpr double kStep = 1e-5;
  for (double t = kStep; t < 1 - kStep; t += 1.0 / 64) {
    for (int k = 0; k < 4; ++k) {
      const double first = (Basis(t + kStep)[k] - Basis(t - kStep)[k]) / (2 * kStep);
      EXPECT_NEAR(BasisFirstDerivative(t)[k], first, 1e-9);
      const double second =
          (BasisFirstDerivative(t + kStep)[k] - BasisFirstDerivative(t - kStep)[k]) / (2 * kStep);
      EXPECT_NEAR(BasisSecondDerivative(t)[k], second, 1e-9);
    }
  }
}

TEST(BasisTest, NormalizedWeightsMakeTheUpdateExact) {
  // phi^T (phi kappa / |phi|^2) = kappa: the surface changes by kappa at the measured point, (34).
  for (double t = 0; t < 1; t += 1.0 / 64) {
    const BasisWeights b = Basis(t);
    const BasisWeights n = NormalizedBasis(t);
    EXPECT_NEAR(std::inner_product(b.begin(), b.end(), n.begin(), 0.0), 1, 1e-15);
  }
}

}  // namespace splinemap::basis_test
