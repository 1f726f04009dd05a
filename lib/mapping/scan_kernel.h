#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "lib/mapping/free_line_table.h"
#include "lib/mapping/sum_plane.h"
#include "splinemap/tile.h"

namespace splinemap {

// Sums of a scan have this many bits more than control points: 64 units are one of theirs.
inline constexpr int kSumFractionBits = 6;

// A PlacedBeam as it lies in memory. Kernels must not know its classes, whose inline functions
// might be linked from there into the rest of the program.
struct BeamMemory {
  double origin_world_m[2];
  double direction_world[2];
  double range_m;
  bool hit;
};

struct FreeLineCounts {
  size_t steep = 0;
  size_t shallow = 0;
};

// How beams become free lines.
struct FreeLineModel {
  double knots_per_m = 0;
  double end_before_hit_knots = 0;
  const int32_t* row_pairs = nullptr;  // FreeLineTable::data()
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

  // Sets steep_lines and shallow_lines, arrays for count + 1 lines each, to the free part of the
  // beams that are steep to the x axis (rows of constant y), and of those steep to the y axis.
  FreeLineCounts (*set_lines)(const BeamMemory* beams, size_t count, const FreeLineModel& model,
                              FreeLine* steep_lines, FreeLine* shallow_lines);

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
