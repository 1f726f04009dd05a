#include "lib/mapping/free_line_table.h"

#include <algorithm>
#include <cmath>

#include "lib/spline/basis.h"

namespace splinemap {
namespace {

constexpr int kWidth = FreeLine::kWidth;
constexpr int kPhases = FreeLine::kPhases;
constexpr int kStepsPerKnot = 16;  // of the midpoint rule

using Row = std::array<double, kWidth>;

// For a beam that adds 1 per knot interval and crosses the row at column x, where columns count
// from the first of the row.
Row Integrate(double slope, double x) {
  Row row{};
  for (int step = -2 * kStepsPerKnot; step < 2 * kStepsPerKnot; ++step) {
    const double v = (step + 0.5) / kStepsPerKnot;
    // The row is control point 3, 2, 1, 0 of the knot interval that y + v is in.
    const double below = std::floor(v);
    const double row_weight = NormalizedBasis(v - below)[1 - static_cast<int>(below)];
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
    const double x = static_cast<double>(phase) / kPhases - FreeLineTable::FirstColumn(slope);
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
  for (const UnitPairs& pairs : unit_table) {
    auto sum = by_slope_.emplace_back().begin();
    for (const std::array<Row, 2>& pair : pairs) {
      for (const Row& row : pair) {
        for (const double unit : row) {
          *sum++ = static_cast<int32_t>(RoundToInt(sum_per_knot * unit));
        }
      }
    }
  }
}

}  // namespace splinemap
