#include "lib/mapping/free_line_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "lib/base/lanes.h"
#include "lib/spline/basis.h"

namespace splinemap {
namespace {

constexpr int kWidth = FreeLine::kWidth;
constexpr int kPhases = FreeLine::kPhases;
constexpr int kStepsPerKnot = 16;  // of the midpoint rule

using Row = std::array<double, kWidth>;

// The row is control point 3, 2, 1, 0 of the knot interval that y + v is in.
std::array<double, 4 * kStepsPerKnot> MakeRowWeights() {
  std::array<double, 4 * kStepsPerKnot> weights;
  for (int step = 0; step < kStepsPerKnot; ++step) {
    const BasisWeights of_interval = NormalizedBasis((step + 0.5) / kStepsPerKnot);
    for (int k = 0; k < 4; ++k) weights[(3 - k) * kStepsPerKnot + step] = of_interval[k];
  }
  return weights;
}

// For a beam that adds 1 per knot interval and crosses the row at column x, where columns count
// from the first of the row.
Row Integrate(double slope, double x) {
  static const auto row_weights = MakeRowWeights();
  Row row{};
  for (int step = -2 * kStepsPerKnot; step < 2 * kStepsPerKnot; ++step) {
    const double v = (step + 0.5) / kStepsPerKnot;
    const double row_weight = row_weights[step + 2 * kStepsPerKnot];
    const double column = x + slope * v;
    const double cell = std::floor(column);
    const BasisWeights weights = NormalizedBasis(column - cell);
    for (int k = 0; k < 4; ++k) {
      row[std::clamp(static_cast<int>(cell) - 1 + k, 0, kWidth - 1)] += row_weight * weights[k];
    }
  }
  const double knots_per_step = std::sqrt(1 + slope * slope) / kStepsPerKnot;
  for (double& sum : row) sum *= knots_per_step;
  return row;
}

using UnitPairs = std::array<std::array<Row, 2>, kPhases>;

UnitPairs MakeUnitPairs(double slope) {
  UnitPairs pairs;
  for (int phase = 0; phase < kPhases; ++phase) {
    const double x = static_cast<double>(phase) / kPhases - FreeLineTable::FirstColumn(slope < 0);
    pairs[phase] = {Integrate(slope, x), Integrate(slope, x + slope)};
  }
  return pairs;
}

std::vector<UnitPairs> MakeUnitTable(int slopes_per_one) {
  std::vector<UnitPairs> table;
  for (int n = -slopes_per_one; n <= slopes_per_one; ++n) {
    table.push_back(MakeUnitPairs(static_cast<double>(n) / slopes_per_one));
  }
  return table;
}

}  // namespace

FreeLineTable::FreeLineTable(double sum_per_knot) {
  static const std::vector<UnitPairs> unit_table = MakeUnitTable(kSlopesPerOne);
  static_assert(sizeof(UnitPairs) == kSumsPerSlope * sizeof(double));
  sums_.resize(unit_table.size() * kSumsPerSlope);
  const double* units = unit_table.front().front().front().data();
  for (size_t n = 0; n < sums_.size(); n += 4) {
    Doubles4 four;
    std::memcpy(&four, units + n, sizeof(four));
    const auto rounded = __builtin_convertvector(Floor(sum_per_knot * four + 0.5), Integers4);
    std::memcpy(&sums_[n], &rounded, sizeof(rounded));
  }
}

}  // namespace splinemap
