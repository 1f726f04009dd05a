#include "lib/spline/surface.h"

#include <cmath>
#include <cstring>

#include "lib/spline/patch_kernel.h"

namespace splinemap {

SurfaceSample EvaluatePatch(const ControlPatch& control_points, double t_x, double t_y,
                            double knot_interval_m) {
  PatchRow rows[4];
  std::memcpy(rows, control_points.data(), sizeof(rows));
  SurfaceSample sample;
  EvaluateRows(rows, t_x, t_y, knot_interval_m, sample);
  return sample;
}

double Probability(double log_odds) {
  // The exponential of a negative number cannot overflow.
  if (log_odds >= 0) return 1 / (1 + std::exp(-log_odds));
  const double odds = std::exp(log_odds);
  return odds / (1 + odds);
}

}  // namespace splinemap
