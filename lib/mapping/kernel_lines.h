#pragma once

// Beams as lines over rows of control points. A part of scan_kernel_impl.h.

#include "lib/mapping/kernel_lanes.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// Four beams in the plane of the axis that each is steep to.
struct FourBeams {
  Longs4 is_steep;  // to the x axis
  Doubles4 along;   // that axis
  Doubles4 across;
  Doubles4 d_along;
  Doubles4 d_across;
  Doubles4 range;
};

[[gnu::always_inline]] inline FourBeams LoadFour(const BeamMemory* beams, double knots_per_m) {
  const auto [x, y, dx, dy, range] = LoadPlaced(beams, knots_per_m);
  const Longs4 is_steep = ~IsLess(Abs(dy), Abs(dx));
  return {is_steep,
          Select(is_steep, y, x),
          Select(is_steep, x, y),
          Select(is_steep, dy, dx),
          Select(is_steep, dx, dy),
          range};
}

// The lines of four beams.
struct FourLines {
  Doubles4 cell;  // of the first control point touched
  Longs4 column;
  Integers4 of_line[4];  // what follows in a FreeLine, by line
  Integers4 rows;
};

[[gnu::always_inline]] inline FourLines SetFour(const FourBeams& beams, Doubles4 slope,
                                                Doubles4 first_row, Doubles4 last_row) {
  using Table = FreeLineTable<int32_t>;
  const Doubles4 slope_index = Floor(slope * Table::kSlopesPerOne + 0.5);
  const Doubles4 first_column =
      Select(IsLess(slope_index, Doubles4{}), Doubles4{} + Table::FirstColumn(true),
             Doubles4{} + Table::FirstColumn(false));
  constexpr double kOne = int64_t{1} << FreeLine::kFractionBits;
  constexpr double kHalfPhase = 0.5 / Table::kPhases;
  const Doubles4 column =
      beams.across + (first_row - beams.along) * slope + (first_column + kHalfPhase);
  const Doubles4 cell = Floor(column);
  const auto fraction = __builtin_convertvector(Floor((column - cell) * kOne + 0.5), Integers4);
  FourLines lines;
  lines.cell = cell;
  lines.column = (__builtin_convertvector(__builtin_convertvector(cell, Integers4), Longs4)
                  << FreeLine::kFractionBits) +
                 __builtin_convertvector(fraction, Longs4);
  lines.rows = __builtin_convertvector(last_row - first_row, Integers4) + 1;
  lines.of_line[0] = __builtin_convertvector(Floor(slope * kOne + 0.5), Integers4);
  lines.of_line[1] = __builtin_convertvector(first_row, Integers4);
  lines.of_line[2] = lines.rows;
  lines.of_line[3] = __builtin_convertvector(slope_index, Integers4) + Table::kSlopesPerOne;
  Transpose(lines.of_line);
  return lines;
}

[[gnu::always_inline]] inline void StoreLine(const FourLines& lines, int k, FreeLine& line) {
  static_assert(offsetof(FreeLine, slope) == offsetof(FreeLine, columns_per_row) + 12);
  line.column = lines.column[k];
  Store(lines.of_line[k], &line.columns_per_row);
}

// The free part of four beams: the rows of control points between the ends of a line. Those of no
// length, and those that cross no row, are left out.
void SetFourLines(const BeamMemory* memory, const FreeLineModel& model, FreeLine* steep_lines,
                  FreeLine* shallow_lines, LineCounts& counts) {
  const FourBeams beams = LoadFour(memory, model.knots_per_m);
  const Doubles4 length_or_less = beams.range - model.end_before_hit_knots;
  const Longs4 has_length = IsLess(Doubles4{}, length_or_less);
  const Doubles4 length = Select(has_length, length_or_less, Doubles4{});
  const Doubles4 slope = beams.d_across / Select(has_length, beams.d_along, Doubles4{} + 1);
  const Doubles4 end = beams.along + length * beams.d_along;
  const Doubles4 first_row = Floor(Lesser(end, beams.along)) + 1;
  const Doubles4 last_row = Floor(Greater(end, beams.along));
  const FourLines lines = SetFour(beams, slope, first_row, last_row);
  for (int k = 0; k < 4; ++k) {
    const bool is_steep = beams.is_steep[k] != 0;
    StoreLine(lines, k, is_steep ? steep_lines[counts.steep] : shallow_lines[counts.shallow]);
    const bool is_line = has_length[k] != 0 && lines.rows[k] > 0;
    counts.steep += is_line && is_steep ? 1 : 0;
    counts.shallow += is_line && !is_steep ? 1 : 0;
  }
}

LineCounts SetLines(const BeamMemory* beams, size_t count, const FreeLineModel& model,
                    FreeLine* steep_lines, FreeLine* shallow_lines) {
  LineCounts counts;
  size_t n = 0;
  for (; n + 4 <= count; n += 4) {
    SetFourLines(beams + n, model, steep_lines, shallow_lines, counts);
  }
  if (n < count) {
    BeamMemory last[4] = {};  // a beam of zeros has no free part
    __builtin_memcpy(last, beams + n, (count - n) * sizeof *beams);
    SetFourLines(last, model, steep_lines, shallow_lines, counts);
  }
  return counts;
}

// Four floats as they lie in memory.
[[gnu::always_inline]] inline Integers4 Floats(Doubles4 v) {
  return reinterpret_cast<Integers4>(__builtin_convertvector(v, Floats4));
}

// Four beams cut in two: the rows of control points before their faces, and those that take part in
// them.
void SetFourFaceLines(const BeamMemory* memory, const Face* faces, double knots_per_m,
                      FreeLine* steep_lines, FreeLine* shallow_lines, FaceLine* steep_faces,
                      FaceLine* shallow_faces, ScanKernel::FaceLineCounts& counts) {
  const FourBeams beams = LoadFour(memory, knots_per_m);
  Doubles4 face_of[4];
  for (int k = 0; k < 4; ++k) face_of[k] = Load<Doubles4>(&faces[k]);
  Transpose(face_of);
  const auto [normal_x, normal_y, before, behind] = face_of;
  const Doubles4 length_or_less = beams.range - before;
  const Doubles4 length = Greater(length_or_less, Doubles4{});
  const Longs4 is_forward = IsLess(Doubles4{}, beams.d_along);
  const Longs4 has_length = IsLess(Doubles4{}, beams.range);
  const Doubles4 slope = beams.d_across / Select(has_length, beams.d_along, Doubles4{} + 1);

  const Doubles4 begin_row = Floor(beams.along);
  const Doubles4 cut_row = Floor(beams.along + length * beams.d_along);
  const Doubles4 end = beams.along + (beams.range + behind) * beams.d_along;
  const Doubles4 end_row = Floor(end);
  const FourLines free = SetFour(beams, slope, Select(is_forward, begin_row, cut_row) + 1,
                                 Select(is_forward, cut_row, begin_row));
  const Doubles4 first_row = Select(is_forward, cut_row, end_row) + 1;
  const FourLines face = SetFour(beams, slope, first_row, Select(is_forward, end_row, cut_row));

  const Doubles4 per_row_behind = 1 / (behind * beams.d_along);
  const Doubles4 part = (end - first_row) * per_row_behind;

  // How far the first control point lies behind the face.
  constexpr double kSharePerKnot =
      SignedDistance::kWholeShare / (SignedDistance::kFrontKnots + SignedDistance::kBackKnots);
  const Doubles4 per_row = Select(beams.is_steep, normal_y, normal_x) * kSharePerKnot;
  const Doubles4 per_column = Select(beams.is_steep, normal_x, normal_y) * kSharePerKnot;
  const Doubles4 share = (first_row - (beams.along + beams.range * beams.d_along)) * per_row +
                         (face.cell - (beams.across + beams.range * beams.d_across)) * per_column +
                         SignedDistance::kFrontKnots * kSharePerKnot;

  Integers4 of_face[4] = {Floats(share), Floats(per_column), Floats(per_row), Floats(part)};
  Transpose(of_face);
  const Integers4 part_per_row = Floats(-per_row_behind);
  const Integers4 is_steep = __builtin_convertvector(beams.is_steep, Integers4);
  const Integers4 is_line = free.rows > 0;
  const Integers4 is_face = face.rows > 0;
  for (int k = 0; k < 4; ++k) {
    const bool steep = is_steep[k] != 0;
    StoreLine(free, k, steep ? steep_lines[counts.free.steep] : shallow_lines[counts.free.shallow]);
    FaceLine& line = steep ? steep_faces[counts.face.steep] : shallow_faces[counts.face.shallow];
    static_assert(offsetof(FaceLine, part) == offsetof(FaceLine, share) + 12);
    StoreLine(face, k, line.line);
    Store(of_face[k], &line.share);
    Store(part_per_row[k], &line.part_per_row);
    line.weight = faces[k].weight;
    const int32_t has_line = is_line[k] & 1;
    const int32_t has_face = is_face[k] & int32_t{memory[k].hit};
    counts.free.steep += has_line & is_steep[k];
    counts.free.shallow += has_line & ~is_steep[k];
    counts.face.steep += has_face & is_steep[k];
    counts.face.shallow += has_face & ~is_steep[k];
  }
}

ScanKernel::FaceLineCounts SetFaceLines(const BeamMemory* beams, const Face* faces, size_t count,
                                        double knots_per_m, FreeLine* steep_lines,
                                        FreeLine* shallow_lines, FaceLine* steep_faces,
                                        FaceLine* shallow_faces) {
  ScanKernel::FaceLineCounts counts;
  size_t n = 0;
  for (; n + 4 <= count; n += 4) {
    SetFourFaceLines(beams + n, faces + n, knots_per_m, steep_lines, shallow_lines, steep_faces,
                     shallow_faces, counts);
  }
  if (n < count) {
    BeamMemory last[4] = {};  // a beam of zeros has no part
    Face last_faces[4] = {};
    __builtin_memcpy(last, beams + n, (count - n) * sizeof *beams);
    __builtin_memcpy(last_faces, faces + n, (count - n) * sizeof *faces);
    SetFourFaceLines(last, last_faces, knots_per_m, steep_lines, shallow_lines, steep_faces,
                     shallow_faces, counts);
  }
  return counts;
}

}  // namespace
}  // namespace splinemap::SPLINEMAP_KERNEL
