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

BasisWeights LinearBasis(double t) { return {0, 1 - t, t, 0}; }

// The weights of the four control points around a phase, and of the rows around a point.
struct Shares {
  BasisWeights (*of_phase)(double t);
  std::array<double, 4 * kStepsPerKnot> of_rows;
};

// The row is control point 3, 2, 1, 0 of the knot interval that y + v is in.
Shares MakeShares(BasisWeights (*of_phase)(double t)) {
  Shares shares{of_phase, {}};
  for (int step = 0; step < kStepsPerKnot; ++step) {
    const BasisWeights of_interval = of_phase((step + 0.5) / kStepsPerKnot);
    for (int k = 0; k < 4; ++k) shares.of_rows[(3 - k) * kStepsPerKnot + step] = of_interval[k];
  }
  return shares;
}

// For a beam that adds 1 per knot interval and crosses the row at column x, where columns count
// from the first of the row.
Row Integrate(const Shares& shares, double slope, double x) {
  Row row{};
  for (int step = -2 * kStepsPerKnot; step < 2 * kStepsPerKnot; ++step) {
    const double v = (step + 0.5) / kStepsPerKnot;
    const double row_weight = shares.of_rows[step + 2 * kStepsPerKnot];
    const double column = x + slope * v;
    const double cell = std::floor(column);
    const BasisWeights weights = shares.of_phase(column - cell);
    for (int k = 0; k < 4; ++k) {
      row[std::clamp(static_cast<int>(cell) - 1 + k, 0, kWidth - 1)] += row_weight * weights[k];
    }
  }
  const double knots_per_step = std::sqrt(1 + slope * slope) / kStepsPerKnot;
  for (double& sum : row) sum *= knots_per_step;
  return row;
}

using UnitPairs = std::array<std::array<Row, 2>, kPhases>;

UnitPairs MakeUnitPairs(const Shares& shares, double slope) {
  UnitPairs pairs;
  for (int phase = 0; phase < kPhases; ++phase) {
    const double x = static_cast<double>(phase) / kPhases - FreeLineTable::FirstColumn(slope < 0);
    pairs[phase] = {Integrate(shares, slope, x), Integrate(shares, slope, x + slope)};
  }
  return pairs;
}

std::vector<UnitPairs> MakeUnitTable(const Shares& shares, int slopes_per_one) {
  std::vector<UnitPairs> table;
  for (int n = -slopes_per_one; n <= slopes_per_one; ++n) {
    table.push_back(MakeUnitPairs(shares, static_cast<double>(n) / slopes_per_one));
  }
  return table;
}

const std::vector<UnitPairs>& UnitTable(Footprint footprint) {
  constexpr int kSlopes = FreeLineTable::kSlopesPerOne;
  if (footprint == Footprint::kLinear) {
    static const std::vector<UnitPairs> linear = MakeUnitTable(MakeShares(&LinearBasis), kSlopes);
    return linear;
  }
  if (footprint == Footprint::kBasis) {
    static const std::vector<UnitPairs> basis = MakeUnitTable(MakeShares(&Basis), kSlopes);
    return basis;
  }
  static const std::vector<UnitPairs> normalized =
      MakeUnitTable(MakeShares(&NormalizedBasis), kSlopes);
  return normalized;
}

}  // namespace

FreeLineTable::FreeLineTable(double sum_per_knot, Footprint footprint) {
  const std::vector<UnitPairs>& unit_table = UnitTable(footprint);
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
