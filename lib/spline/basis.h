#pragma once

#include <array>

namespace splinemap {

// Values of the four cubic cardinal B-splines that are not zero on one knot interval. For
// x in [i dt, (i+1) dt) and t = x/dt - i, entry k belongs to control point i - 1 + k.
using BasisWeights = std::array<double, 4>;

// The weights, their first and their second derivative by t; t in [0, 1). From the recursion (1) of
// "B-spline Surfaces for Range-Based Environment Mapping" for a constant knot interval.
BasisWeights Basis(double t);
BasisWeights BasisFirstDerivative(double t);
BasisWeights BasisSecondDerivative(double t);

// Basis(t) / |Basis(t)|^2: one axis of phi / |phi|^2 in the measurement update (35), which is the
// outer product of this for x and for y.
BasisWeights NormalizedBasis(double t);

}  // namespace splinemap
