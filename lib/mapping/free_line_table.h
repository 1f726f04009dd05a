#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "lib/geometry/angle.h"
#include "lib/mapping/scan_kernel.h"

namespace splinemap {

// What a beam through free space adds to one row of control points: the integral of the update (35)
// along the beam, which is the expectation of its samples (9) over their phase.
//
// A beam that is steep to a row crosses it at column x with the slope m = dx/dy, |m| <= 1. Its
// points within reach of the row, y + v with v in (-2, 2), have columns x + m v. So it touches the
// control points floor(x) - 3 .. floor(x) + 4; in the next row, seen from the same columns, one
// more on one side. That one, which gets less than a thousandth, is added to its neighbour.
// Immutable.
class FreeLineTable {
 public:
  // `sum_per_knot`: what one knot interval of beam adds, in units of the sums of a scan.
  explicit FreeLineTable(double sum_per_knot);

  // For the nearest slope that is in the table.
  struct Entry {
    const int32_t* row_pairs;  // of FreeLine
    int first_column;          // of FreeLine::kWidth, from floor(x) in the first row of a pair
  };
  // Requires |slope| <= 1.
  Entry Find(double slope) const {
    const int64_t index = RoundToInt(slope * kSlopesPerOne);
    return {by_slope_[index + kSlopesPerOne].data(), FirstColumn(static_cast<double>(index))};
  }
  static constexpr int FirstColumn(double slope) { return slope < 0 ? -4 : -3; }

 private:
  static constexpr int kSlopesPerOne = 64;
  using RowPairSums = std::array<int32_t, size_t{FreeLine::kPhases} * 2 * FreeLine::kWidth>;
  std::vector<RowPairSums> by_slope_;
};

}  // namespace splinemap
