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

// Numbers of lines that are steep to the x axis (rows of constant y), and of those steep to the y
// axis.
struct LineCounts {
  size_t steep = 0;
  size_t shallow = 0;
};

// How beams become free lines.
struct FreeLineModel {
  double knots_per_m = 0;
  double end_before_hit_knots = 0;          // where there are no `faces`
  const int32_t* row_pairs = nullptr;       // FreeLineTable::data()
  const int32_t* face_row_pairs = nullptr;  // likewise, for the lines of faces
};

// The surface where a beam hits it, as the beams beside tell.
struct Face {
  double normal[2];     // of unit length, away from the sensor
  double before_knots;  // from so far before the hit to so far behind it, along the beam, control
  double behind_knots;  // points take part in the face
  int32_t weight;       // of the beam there; 1: as in free space
};

// The part of a beam around its hit: a line, and how the share of what is occupied grows over it.
struct FaceLine {
  FreeLine line;
  int32_t weight = 0;
  // In 1 / kWholeShare: in the first row at the first control point; per control point; per row.
  float share = 0;
  float share_per_column = 0;
  float share_per_row = 0;
  // Of the weight: in the first row, and per row. 1 and more is all of it, up to the hit; behind it
  // that falls to 0.
  float part = 0;
  float part_per_row = 0;
};

// The signed distance of a control point to a face, in front of it negative, as a share of
// occupied: 0 at kFrontKnots before and 1 at kBackKnots behind, between them it grows evenly.
struct SignedDistance {
  static constexpr double kFrontKnots = 1;
  static constexpr double kBackKnots = 0.75;
  static constexpr int kWholeShare = 256;
  // One knot interval of beam weighs as much; so much of one scan counts in one control point.
  static constexpr int kWeightPerKnot = 360;
  static constexpr int kMostWeight = 2048;
  // A scan's share of a control point is weight / 2^kForgetBits, so at most a quarter.
  static constexpr int kForgetBits = 13;
  // The values of a control point that is free, and that is occupied; 0 is the face.
  static constexpr int kFree = -8 * kUnitsPerLogOdds;
  static constexpr int kOccupied = 6 * kUnitsPerLogOdds;
  static_assert(kFree * kBackKnots == -kOccupied * kFrontKnots);
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
  LineCounts (*set_lines)(const BeamMemory* beams, size_t count, const FreeLineModel& model,
                          FreeLine* steep_lines, FreeLine* shallow_lines);
  // Likewise of beams with faces, one for each: the lines before the faces, and those of the faces.
  struct FaceLineCounts {
    LineCounts free;
    LineCounts face;
  };
  FaceLineCounts (*set_face_lines)(const BeamMemory* beams, const Face* faces, size_t count,
                                   const FreeLineModel& model, FreeLine* steep_lines,
                                   FreeLine* shallow_lines, FaceLine* steep_faces,
                                   FaceLine* shallow_faces);

  void (*add_lines)(const FreeLine* lines, size_t count, SumPlane& plane);
  void (*add_faces)(const FaceLine* faces, size_t count, SumPlane& weights, SumPlane& occupied);
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
  // Moves weights and the occupied part of them, null where there is none, into control points:
  // `to` becomes what they make of `from`. Whether that is a change. See SignedDistance. Requires
  // that what is occupied has weight.
  bool (*commit_distances)(int32_t* weights, int32_t* occupied, ControlLimits limits,
                           const ControlPoint* from, ControlPoint* to);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<ScanKernel>& ScanKernels();
inline const ScanKernel& FastestScanKernel() { return ScanKernels().back(); }

}  // namespace splinemap
