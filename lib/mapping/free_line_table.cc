#include "lib/mapping/free_line_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "lib/base/lanes.h"
#include "lib/spline/basis.h"

namespace splinemap {
namespace {

constexpr int kWidth = FreeLineTable<int32_t>::kWidth;
constexpr int kPhases = LineTable::kPhases;
constexpr int kSlopesPerOne = LineTable::kSlopesPerOne;
constexpr int kStepsPerKnot = 16;  // of the midpoint rule

using Row = std::array<double, kWidth>;

int FirstColumn(bool is_negative) { return FreeLineTable<int32_t>::FirstColumn(is_negative); }

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
    const double x = static_cast<double>(phase) / kPhases - FirstColumn(slope < 0);
    pairs[phase] = {Integrate(shares, slope, x), Integrate(shares, slope, x + slope)};
  }
  return pairs;
}

std::vector<UnitPairs> MakeUnitTable(BasisWeights (*of_phase)(double t)) {
  const Shares shares = MakeShares(of_phase);
  std::vector<UnitPairs> table;
  for (int n = -kSlopesPerOne; n <= kSlopesPerOne; ++n) {
    table.push_back(MakeUnitPairs(shares, static_cast<double>(n) / kSlopesPerOne));
  }
  return table;
}

const std::vector<UnitPairs>& UnitTable(Footprint footprint) {
  if (footprint == Footprint::kBasis) {
    static const std::vector<UnitPairs> basis = MakeUnitTable(&Basis);
    return basis;
  }
  static const std::vector<UnitPairs> normalized = MakeUnitTable(&NormalizedBasis);
  return normalized;
}

// Beside its neighbours.
using UnitRows = std::array<std::array<double, FaceLineTable::kWidth>, kPhases>;

const std::vector<UnitRows>& UnitFaceTable() {
  static const std::vector<UnitRows> table = [] {
    const Shares shares = MakeShares(&LinearBasis);
    std::vector<UnitRows> rows;
    for (int n = -kSlopesPerOne; n <= kSlopesPerOne; ++n) {
      const int first = FaceLineTable::kFirstColumn - FirstColumn(n < 0);
      UnitRows& of_slope = rows.emplace_back();
      for (int phase = 0; phase < kPhases; ++phase) {
        const double x = static_cast<double>(phase) / kPhases - FirstColumn(n < 0);
        const Row row = Integrate(shares, static_cast<double>(n) / kSlopesPerOne, x);
        std::copy_n(&row[first], FaceLineTable::kWidth, of_slope[phase].begin());
      }
    }
    return rows;
  }();
  return table;
}

template <typename Sum, typename UnitTable>
std::vector<Sum> Scaled(const UnitTable& unit_table, double sum_per_knot) {
  using Sums4 [[gnu::vector_size(4 * sizeof(Sum))]] = Sum;
  const auto* units = reinterpret_cast<const double*>(unit_table.data());
  std::vector<Sum> sums(unit_table.size() * sizeof(unit_table[0]) / sizeof(double));
  for (size_t n = 0; n < sums.size(); n += 4) {
    Doubles4 four;
    std::memcpy(&four, units + n, sizeof(four));
    const auto rounded = __builtin_convertvector(
        __builtin_convertvector(Floor(sum_per_knot * four + 0.5), Integers4), Sums4);
    std::memcpy(&sums[n], &rounded, sizeof(rounded));
  }
  return sums;
}

}  // namespace

template <typename Sum>
FreeLineTable<Sum>::FreeLineTable(double sum_per_knot, Footprint footprint)
    : sums_(Scaled<Sum>(UnitTable(footprint), sum_per_knot)) {}

template class FreeLineTable<int32_t>;
template class FreeLineTable<uint16_t>;

FaceLineTable::FaceLineTable(double sum_per_knot)
    : sums_(Scaled<int32_t>(UnitFaceTable(), sum_per_knot)) {}

}  // namespace splinemap
