#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

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

// (cos, sin) of any finite angle, to 3e-16.
inline Eigen::Vector2d UnitVector(double angle_rad) {
  constexpr double kMaxReduced = 1e6;  // beyond, the steps below would lose digits
  if (!(std::abs(angle_rad) < kMaxReduced)) angle_rad = std::remainder(angle_rad, 2 * M_PI);
  // angle = quarters pi/2 + r, with pi/2 in two parts of which the first has 33 bits.
  constexpr double kHalfPiHigh = 0x1.921fb544p+0;
  constexpr double kHalfPiLow = 0x1.0b4611a626331p-34;
  const int64_t quarters = RoundToInt(angle_rad * (2 / M_PI));
  const auto n = static_cast<double>(quarters);
  const double r = (angle_rad - n * kHalfPiHigh) - n * kHalfPiLow;
  const double rr = r * r;
  // Taylor's polynomials; their next terms are below 1e-16 for |r| <= pi/4.
  double sine = -1.0 / 1307674368000;
  sine = sine * rr + 1.0 / 6227020800;
  sine = sine * rr - 1.0 / 39916800;
  sine = sine * rr + 1.0 / 362880;
  sine = sine * rr - 1.0 / 5040;
  sine = sine * rr + 1.0 / 120;
  sine = sine * rr - 1.0 / 6;
  sine = r + r * (rr * sine);
  double cosine = 1.0 / 20922789888000;
  cosine = cosine * rr - 1.0 / 87178291200;
  cosine = cosine * rr + 1.0 / 479001600;
  cosine = cosine * rr - 1.0 / 3628800;
  cosine = cosine * rr + 1.0 / 40320;
  cosine = cosine * rr - 1.0 / 720;
  cosine = cosine * rr + 1.0 / 24;
  cosine = cosine * rr - 0.5;
  cosine = 1 + rr * cosine;
  const bool is_odd = (quarters & 1) != 0;
  const double x = is_odd ? sine : cosine;
  const double y = is_odd ? cosine : sine;
  return {((quarters + 1) & 2) != 0 ? -x : x, (quarters & 2) != 0 ? -y : y};
}

// The angle of the vector (x, y), in [-pi, pi], to 1e-15; 0 for the zero vector.
double AngleOf(double x, double y);

}  // namespace splinemap
