#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "lib/map/tile.h"
#include "lib/mapping/sum_plane.h"

namespace splinemap {

// Sums of a scan have this many bits more than control points: 64 units are one of theirs.
inline constexpr int kSumFractionBits = 6;

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

// A measurement at one point: 4 x 4 sums, the outer product of two rows of weights.
struct PointSample {
  int32_t i = 0;  // of the first control point
  int32_t j = 0;
  const int32_t* x_weights = nullptr;  // [4], in sums
  const int32_t* y_weights = nullptr;  // [4], in 1 / 2^kWeightBits
  static constexpr int kWeightBits = 12;
};

// The inner loops of mapping, compiled for one instruction set. All of them give the same bytes.
struct ScanKernel {
  const char* name;  // "plain", "avx2", "avx512"

  void (*add_lines)(const FreeLine* lines, size_t count, SumPlane& plane);
  void (*add_samples)(const PointSample* samples, size_t count, SumPlane& plane);

  // The rest is about the sums of one tile within its block.

  // Moves the apron of `from` to the sums of `to`, the next tile in x. has_apron: whether there is
  // anything in it.
  bool (*has_apron)(const int32_t* sums);
  void (*move_apron)(int32_t* from, int32_t* to);
  // Moves the sums of `from`, x and y exchanged, to those of `to`. Aprons are left.
  void (*move_transposed)(int32_t* from, int32_t* to);

  // Whether a sum rounds to something.
  bool (*has_change)(const int32_t* sums);
  // Moves the sums, rounded to the nearest (halves to even) and kept within `scan_limits`, to
  // control_points[Tile::kSize]; a sum that rounds to 0 leaves its control point as it was.
  void (*commit)(int32_t* sums, ControlLimits limits, ControlLimits scan_limits,
                 ControlPoint* control_points);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<ScanKernel>& ScanKernels();
inline const ScanKernel& FastestScanKernel() { return ScanKernels().back(); }

}  // namespace splinemap
