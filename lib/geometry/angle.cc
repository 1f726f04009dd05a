#include "lib/geometry/angle.h"

#include <algorithm>
#include <cmath>

#include "lib/geometry/angle_kernel.h"

namespace splinemap {

void UnitVectors(absl::Span<const double> angles_rad, absl::Span<Eigen::Vector2d> units) {
  const bool all_reduced = std::all_of(angles_rad.begin(), angles_rad.end(), [](double angle_rad) {
    return std::abs(angle_rad) < kMaxReduced_rad;
  });
  const size_t in_fours = all_reduced ? angles_rad.size() & ~size_t{3} : 0;
  static const auto set_units = AngleKernels().back().set_units;
  static_assert(sizeof(Eigen::Vector2d) == 2 * sizeof(double));
  set_units(angles_rad.data(), in_fours, reinterpret_cast<double*>(units.data()));
  for (size_t n = in_fours; n < angles_rad.size(); ++n) units[n] = UnitVector(angles_rad[n]);
}

double AngleOf(double x, double y) {
  const double scale = std::max(std::abs(x), std::abs(y));
  if (!(scale > 0)) return 0;
  x /= scale;
  y /= scale;
  const double length = std::sqrt(x * x + y * y);
  // Near enough to begin with: the octant's arc as a straight line.
  const double least = std::min(std::abs(x), std::abs(y));
  double angle = least * (M_PI / 4);
  if (std::abs(y) > std::abs(x)) angle = M_PI / 2 - angle;
  if (x < 0) angle = M_PI - angle;
  if (std::signbit(y)) angle = -angle;
  // What is left is the arc sine of the cross product. Each step leaves a fifth power of the error.
  for (int step = 0; step < 3; ++step) {
    const Eigen::Vector2d unit = UnitVector(angle);
    const double sine = (unit.x() * y - unit.y() * x) / length;
    angle += sine + sine * sine * sine / 6;
  }
  return angle;
}

}  // namespace splinemap
