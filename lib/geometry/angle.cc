#include "lib/geometry/angle.h"

#include <algorithm>
#include <cmath>

namespace splinemap {

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
