#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "absl/types/span.h"

namespace splinemap {

// Sine, cosine and arc tangent made of additions and multiplications alone: unlike those of C
// libraries they give the same bits on every processor that follows IEEE 754, and so do maps.

// floor(x) and the nearest integer (halves up), for |x| < 2^63; std::floor() is a call where the
// processor is not known to have it as an instruction.
inline int64_t FloorToInt(double x) {
  const auto truncated = static_cast<int64_t>(x);
  return truncated - (static_cast<double>(truncated) > x ? 1 : 0);
}
inline int64_t RoundToInt(double x) { return FloorToInt(x + 0.5); }

// pi/2 in two parts, of which the first has 33 bits, and beyond which angle that is too few.
inline constexpr double kHalfPiHigh = 0x1.921fb544p+0;
inline constexpr double kHalfPiLow = 0x1.0b4611a626331p-34;
inline constexpr double kMaxReduced_rad = 1e6;

// Sine and cosine of r, |r| <= pi/4, as Taylor's polynomials, whose next terms are below 1e-16. Of
// a double or of a vector of them.
template <typename Number>
struct SineAndCosine {
  Number sine;
  Number cosine;

  [[gnu::always_inline]] explicit SineAndCosine(const Number& r) {
    const Number rr = r * r;
    Number s = rr * (-1.0 / 1307674368000) + 1.0 / 6227020800;
    s = s * rr - 1.0 / 39916800;
    s = s * rr + 1.0 / 362880;
    s = s * rr - 1.0 / 5040;
    s = s * rr + 1.0 / 120;
    s = s * rr - 1.0 / 6;
    sine = r + r * (rr * s);
    Number c = rr * (1.0 / 20922789888000) - 1.0 / 87178291200;
    c = c * rr + 1.0 / 479001600;
    c = c * rr - 1.0 / 3628800;
    c = c * rr + 1.0 / 40320;
    c = c * rr - 1.0 / 720;
    c = c * rr + 1.0 / 24;
    c = c * rr - 0.5;
    cosine = 1 + rr * c;
  }
};

// (cos, sin) of any finite angle, to 3e-16.
inline Eigen::Vector2d UnitVector(double angle_rad) {
  if (!(std::abs(angle_rad) < kMaxReduced_rad)) angle_rad = std::remainder(angle_rad, 2 * M_PI);
  // angle = quarters pi/2 + r
  const int64_t quarters = RoundToInt(angle_rad * (2 / M_PI));
  const auto n = static_cast<double>(quarters);
  const SineAndCosine<double> of_r((angle_rad - n * kHalfPiHigh) - n * kHalfPiLow);
  const bool is_odd = (quarters & 1) != 0;
  const double x = is_odd ? of_r.sine : of_r.cosine;
  const double y = is_odd ? of_r.cosine : of_r.sine;
  return {((quarters + 1) & 2) != 0 ? -x : x, (quarters & 2) != 0 ? -y : y};
}

// The same for many angles, faster. Requires as many units as angles.
void UnitVectors(absl::Span<const double> angles_rad, absl::Span<Eigen::Vector2d> units);

// The angle of the vector (x, y), in [-pi, pi], to 1e-15; 0 for the zero vector.
double AngleOf(double x, double y);

}  // namespace splinemap
