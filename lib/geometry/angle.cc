#include "lib/geometry/angle.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "lib/base/lanes.h"

namespace splinemap {
namespace {

// Four angles as in UnitVector(), within kMaxReduced_rad; for functions that are compiled for
// several kinds of instructions, which have to inline it.
__attribute__((always_inline)) inline void UnitVectorsOf4(const double* angles_rad,
                                                          Eigen::Vector2d* units) {
  Doubles4 angle_rad;
  std::memcpy(&angle_rad, angles_rad, sizeof(angle_rad));
  const Doubles4 n = Floor(angle_rad * (2 / M_PI) + 0.5);
  const Longs4 quarters = __builtin_convertvector(__builtin_convertvector(n, Integers4), Longs4);
  const SineAndCosine<Doubles4> of_r((angle_rad - n * kHalfPiHigh) - n * kHalfPiLow);
  const Longs4 is_odd = (quarters & 1) != 0;
  const Doubles4 x = is_odd ? of_r.sine : of_r.cosine;
  const Doubles4 y = is_odd ? of_r.cosine : of_r.sine;
  const Doubles4 signed_x = ((quarters + 1) & 2) != 0 ? -x : x;
  const Doubles4 signed_y = (quarters & 2) != 0 ? -y : y;
  const Doubles4 low = __builtin_shufflevector(signed_x, signed_y, 0, 4, 1, 5);
  const Doubles4 high = __builtin_shufflevector(signed_x, signed_y, 2, 6, 3, 7);
  static_assert(sizeof(Eigen::Vector2d) == 2 * sizeof(double));
  std::memcpy(static_cast<void*>(units), &low, sizeof(low));
  std::memcpy(static_cast<void*>(units + 2), &high, sizeof(high));
}

void PlainUnitVectors(const double* angles_rad, size_t count, Eigen::Vector2d* units) {
  for (size_t n = 0; n < count; n += 4) UnitVectorsOf4(angles_rad + n, units + n);
}

#ifdef __x86_64__
__attribute__((target("avx2"))) void Avx2UnitVectors(const double* angles_rad, size_t count,
                                                     Eigen::Vector2d* units) {
  for (size_t n = 0; n < count; n += 4) UnitVectorsOf4(angles_rad + n, units + n);
}
#endif

}  // namespace

void UnitVectors(absl::Span<const double> angles_rad, absl::Span<Eigen::Vector2d> units) {
  const bool all_reduced = std::all_of(angles_rad.begin(), angles_rad.end(), [](double angle_rad) {
    return std::abs(angle_rad) < kMaxReduced_rad;
  });
  const size_t in_fours = all_reduced ? angles_rad.size() & ~size_t{3} : 0;
#ifdef __x86_64__
  static const bool has_avx2 = __builtin_cpu_supports("avx2");
  (has_avx2 ? Avx2UnitVectors : PlainUnitVectors)(angles_rad.data(), in_fours, units.data());
#else
  PlainUnitVectors(angles_rad.data(), in_fours, units.data());
#endif
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
