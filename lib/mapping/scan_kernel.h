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
  double end_before_hit_knots = 0;
};

// Where beams end, for finding what they hit.
struct Hits {
  double* x;  // in knots
  double* y;
  double* spacing;     // of a beam and the next one there, in knots
  int32_t* aside;      // the normal is that of a chord to so many hits on either side
  int32_t* is_beside;  // other than 0: a hit, near enough to the one before for one surface
  static constexpr size_t kMore = 3;  // so many more elements than beams are written

  // Neighbours lie on one surface if they are no further apart than this, or than this many times
  // the distance between their beams.
  static constexpr double kNearKnots = 3;
  static constexpr double kMostObliqueGap = 4;
  // The normal is that of a chord to hits so far on either side, or so many.
  static constexpr double kHalfChordKnots = 2;
  static constexpr int kMostAside = 8;
};

// Between hits on either side of a beam's.
struct Chord {
  double knots[2];
  double behind_knots;  // see Face
  int32_t weight;       // of the face; 0 where there is none
};

// The surface where a beam hits it, as the beams beside tell.
struct Face {
  double normal[2];     // of unit length, away from the sensor
  double before_knots;  // from so far before the hit to so far behind it, along the beam, control
  double behind_knots;  // points take part in the face
  int32_t weight;       // of the beam there; 1: as in free space

  // Lone hits, whose chord is shorter, face the sensor.
  static constexpr double kLeastChordKnots = 1;
  // Beyond 72 degrees of incidence faces are treated as of that.
  static constexpr double kLeastCosine = 0.3;
};

// The part of a beam around its hit: a line, and how the share of what is occupied grows over it.
struct FaceLine {
  static constexpr int kMostRows = 8;
  FreeLine line;
  // In 1 / kWholeShare: in the first row at the first control point; per control point; per row.
  float share = 0;
  float share_per_column = 0;
  float share_per_row = 0;
  // Of the weight: in the first row, and per row. 1 and more is all of it, up to the hit; behind it
  // that falls to 0.
  float part = 0;
  float part_per_row = 0;
  int32_t weight = 0;
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
  static constexpr int kFree = kFreeControlPoint;
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

// What is done with the sums of one tile within its block. Of `groups` of rows only; the others are
// zeros.
template <typename Sum>
struct TileKernel {
  // Moves an apron to the sums of `to`, the tile that it belongs to.
  void (*move_apron)(Sum* apron, uint32_t groups, Sum* to);
  // Moves the sums of `from`, x and y exchanged, to those of `to`. Aprons are left.
  void (*move_transposed)(Sum* from, uint32_t groups, Sum* to);
};

// The inner loops of mapping, compiled for one instruction set. All of them give the same bytes.
struct ScanKernel {
  const char* name;  // "plain", "sse4", "avx2", "avx512", "neon"

  // Sets steep_lines and shallow_lines, arrays for count + 1 lines each, to the free part of the
  // beams that are steep to the x axis (rows of constant y), and of those steep to the y axis.
  LineCounts (*set_lines)(const BeamMemory* beams, size_t count, const FreeLineModel& model,
                          FreeLine* steep_lines, FreeLine* shallow_lines);
  void (*set_hits)(const BeamMemory* beams, size_t count, double knots_per_m, const Hits& hits);
  // One for each beam.
  void (*set_faces)(const BeamMemory* beams, const Chord* chords, size_t count, Face* faces);
  // Likewise of beams with faces, one for each: the lines before the faces, and those of the faces.
  struct FaceLineCounts {
    LineCounts free;
    LineCounts face;
  };
  FaceLineCounts (*set_face_lines)(const BeamMemory* beams, const Face* faces, size_t count,
                                   double knots_per_m, FreeLine* steep_lines,
                                   FreeLine* shallow_lines, FaceLine* steep_faces,
                                   FaceLine* shallow_faces);

  // The tables are the data() of a FreeLineTable and a FaceLineTable. Free lines leave out what
  // their blocks say is settled.
  void (*add_lines)(const FreeLine* lines, size_t count, const int32_t* table,
                    SumPlane<int32_t>& plane);
  void (*add_free_lines)(const FreeLine* lines, size_t count, const uint16_t* table,
                         SumPlane<uint16_t>& plane);
  void (*add_faces)(const FaceLine* faces, size_t count, const int32_t* table,
                    SumPlane<FaceSum>& plane);
  void (*add_samples)(const PointSample* samples, size_t count, SumPlane<int32_t>& plane);

  TileKernel<int32_t> log_odds;
  TileKernel<uint16_t> free;
  TileKernel<FaceSum> faces;

  // Whether a sum rounds to something.
  bool (*has_change)(const int32_t* sums);
  // Moves the sums, rounded to the nearest (halves to even) and kept within `scan_limits`, to
  // control_points[Tile::kSize]; a sum that rounds to 0 leaves its control point as it was.
  void (*commit)(int32_t* sums, ControlLimits limits, ControlLimits scan_limits,
                 ControlPoint* control_points);
  // Moves the sums of a tile into control points: the groups of rows of `to` become what they make
  // of those of `from`; others stay. Whether that is a change. See SignedDistance. `faces` are in
  // `face_cells` only, which are in `groups`; null where there are none. `settled` goes on from
  // SettledCellsOf() the tile before to that of the tile after.
  bool (*commit_distances)(uint16_t* free, uint32_t groups, FaceSum* faces, TileCells face_cells,
                           ControlLimits limits, const ControlPoint* from, ControlPoint* to,
                           TileCells& settled);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<ScanKernel>& ScanKernels();
inline const ScanKernel& FastestScanKernel() { return ScanKernels().back(); }

}  // namespace splinemap
