#pragma once

#include <cstdint>
#include <vector>

namespace splinemap {

// The free part of a beam as the control point rows that it crosses, in a plane whose y axis is the
// one that it is steep to: at most one column to the side per row.
struct FreeLine {
  static constexpr int kFractionBits = 24;
  int64_t column = 0;           // of the first control point touched in the first row, fixed point
  int32_t columns_per_row = 0;  // likewise, within [-1, 1]
  int32_t first_row = 0;
  int32_t rows = 0;  // > 0
  // By the fraction of the column, in kPhases steps: what the line adds to the row where it has
  // that column, 8 sums, and then to the next row, 8 sums of the same columns.
  static constexpr int kPhaseBits = 5;
  static constexpr int kPhases = 1 << kPhaseBits;
  static constexpr int kWidth = 8;
  const int32_t* row_pairs = nullptr;  // [kPhases][2][kWidth]
};

// How a point of a beam is shared among the control points around it, on each axis.
enum class Footprint {
  kNormalizedBasis,  // the paper's update (35): 4 control points
  kBasis,            // as they make up the surface there: 4 control points
  kLinear,           // the two nearest, by their distance
};

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
  FreeLineTable(double sum_per_knot, Footprint footprint);

  // The table has the slopes n / kSlopesPerOne for |n| <= kSlopesPerOne: their FreeLine::row_pairs
  // one after the other.
  static constexpr int kSlopesPerOne = 64;
  static constexpr int kSumsPerSlope = FreeLine::kPhases * 2 * FreeLine::kWidth;
  const int32_t* data() const { return sums_.data(); }

  // Of FreeLine::kWidth, from floor(x) in the first row of a pair, for a slope of the table.
  static constexpr int FirstColumn(bool is_negative) { return is_negative ? -4 : -3; }

 private:
  std::vector<int32_t> sums_;
};

}  // namespace splinemap
