#pragma once

#include "lib/spline/surface.h"

namespace splinemap {

// A row of control points of a patch, or their weights, in the widest vectors that the instructions
// of the caller have.
typedef double PatchRow __attribute__((vector_size(32)));

// EvaluatePatch() for functions that are compiled for several kinds of instructions, which have to
// inline it. Without fused multiplications all give the same bytes. Writes all of `sample` but
// `known`, each number once: a copy would wait for them.
__attribute__((always_inline)) inline void EvaluateRows(const PatchRow (&c)[4], double t_x,
                                                        double t_y, double knot_interval_m,
                                                        SurfaceSample& sample) {
  // The pieces of the cubic basis spline as polynomials in t; see Basis().
  constexpr double kSixth = 1.0 / 6;
  const PatchRow k0 = {kSixth, 4 * kSixth, kSixth, 0};
  const PatchRow k1 = {-0.5, 0, 0.5, 0};
  const PatchRow k2 = {0.5, -1, 0.5, 0};
  const PatchRow k3 = {-kSixth, 0.5, -0.5, kSixth};

  // s = by^T C bx, equation (4) with rows for y. Derivatives are by phase until the end.
  const PatchRow by = ((k3 * t_y + k2) * t_y + k1) * t_y + k0;
  const PatchRow dby = (3 * k3 * t_y + 2 * k2) * t_y + k1;
  const PatchRow ddby = 6 * k3 * t_y + 2 * k2;
  const PatchRow by_c = (by[0] * c[0] + by[1] * c[1]) + (by[2] * c[2] + by[3] * c[3]);
  const PatchRow dby_c = (dby[0] * c[0] + dby[1] * c[1]) + (dby[2] * c[2] + dby[3] * c[3]);
  const PatchRow ddby_c = (ddby[0] * c[0] + ddby[1] * c[1]) + (ddby[2] * c[2] + ddby[3] * c[3]);
  const PatchRow bx = ((k3 * t_x + k2) * t_x + k1) * t_x + k0;
  const PatchRow dbx = (3 * k3 * t_x + 2 * k2) * t_x + k1;
  const PatchRow ddbx = 6 * k3 * t_x + 2 * k2;
  const auto dot = [](const PatchRow& a, const PatchRow& b) __attribute__((always_inline)) {
    const PatchRow products = a * b;
    return (products[0] + products[1]) + (products[2] + products[3]);
  };

  const double per_m = 1 / knot_interval_m;
  const double per_m2 = per_m * per_m;
  sample.log_odds = dot(by_c, bx);
  sample.gradient_per_m.x() = per_m * dot(by_c, dbx);
  sample.gradient_per_m.y() = per_m * dot(dby_c, bx);
  sample.hessian_per_m2(0, 0) = per_m2 * dot(by_c, ddbx);
  sample.hessian_per_m2(1, 1) = per_m2 * dot(ddby_c, bx);
  const double mixed = per_m2 * dot(dby_c, dbx);
  sample.hessian_per_m2(0, 1) = mixed;
  sample.hessian_per_m2(1, 0) = mixed;
}

}  // namespace splinemap
