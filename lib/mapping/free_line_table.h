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
  int32_t rows = 0;   // > 0
  int32_t slope = 0;  // of a LineTable
};

// How a point of a beam is shared among the 4 control points around it, on each axis.
enum class Footprint {
  kNormalizedBasis,  // the paper's update (35)
  kBasis,            // as they make up the surface there
};

// How tables of what lines add to rows of control points are made up: by slope, and by the fraction
// of the column, which is the phase.
struct LineTable {
  // The slopes n / kSlopesPerOne for |n| <= kSlopesPerOne.
  static constexpr int kSlopesPerOne = 64;
  static constexpr int kSlopes = 2 * kSlopesPerOne + 1;
  static constexpr int kPhaseBits = 5;
  static constexpr int kPhases = 1 << kPhaseBits;
};

// What a beam through free space adds to one row of control points: the integral of the update (35)
// along the beam, which is the expectation of its samples (9) over their phase.
//
// A beam that is steep to a row crosses it at column x with the slope m = dx/dy, |m| <= 1. Its
// points within reach of the row, y + v with v in (-2, 2), have columns x + m v. So it touches the
// control points floor(x) - 3 .. floor(x) + 4; in the next row, seen from the same columns, one
// more on one side. That one, which gets less than a thousandth, is added to its neighbour.
// Immutable.
template <typename Sum>
class FreeLineTable : public LineTable {
 public:
  // `sum_per_knot`: what one knot interval of beam adds, in units of the sums of a scan.
  FreeLineTable(double sum_per_knot, Footprint footprint);

  // By slope and phase: what the line adds to the row where it has that column, kWidth sums, and
  // then to the next row, kWidth sums of the same columns.
  static constexpr int kWidth = 8;
  static constexpr int kSumsPerSlope = kPhases * 2 * kWidth;
  const Sum* data() const { return sums_.data(); }

  // Of kWidth, from floor(x) in the first row of a pair, for a slope of the table.
  static constexpr int FirstColumn(bool is_negative) { return is_negative ? -4 : -3; }

 private:
  std::vector<Sum> sums_;
};

// The same of a beam whose points are shared among the two nearest control points on each axis:
// floor(x) - 1 .. floor(x) + 2, one row at a time. Immutable.
class FaceLineTable : public LineTable {
 public:
  explicit FaceLineTable(double sum_per_knot);

  // By slope and phase.
  static constexpr int kWidth = 4;
  static constexpr int kSumsPerSlope = kPhases * kWidth;
  const int32_t* data() const { return sums_.data(); }

  static constexpr int kFirstColumn = -1;

 private:
  std::vector<int32_t> sums_;
};

}  // namespace splinemap
