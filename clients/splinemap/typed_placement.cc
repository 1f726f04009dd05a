#include "clients/splinemap/typed_placement.h"

#include <cmath>

namespace splinemap {
namespace {

constexpr double kUnitsPerDegree = 4294967296 / 360.0;

double Typed(int64_t units, double units_per_one) {
  const double number = static_cast<double>(units) / units_per_one;
  for (double digits = 1e6; digits < 1e9; digits *= 10) {
    const double rounded = std::round(number * digits) / digits;
    if (std::llround(rounded * units_per_one) == units) return rounded + 0.0;  // without a -0
  }
  return number;
}

}  // namespace

TypedPlacement::TypedPlacement(const FixedPose2& placement)
    : x_m(Typed(placement.x, FixedPose2::kUnitsPerMetre)),
      y_m(Typed(placement.y, FixedPose2::kUnitsPerMetre)),
      yaw_deg(Typed(placement.yaw, kUnitsPerDegree)) {}

}  // namespace splinemap
