// The body of a ScanKernel, included by one file for each instruction set, which defines
// SPLINEMAP_KERNEL as the name of its namespace.
//
// What is called in here is local to the file, always inlined, or not inline at all: an inline
// function that the linker took from here into the rest of the program might not run there.

#include <cstddef>
#include <cstdint>
#ifdef __SSE2__
#include <immintrin.h>
#endif

#include "lib/base/lanes.h"
#include "lib/mapping/scan_kernel.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// As many sums as a register of the instruction set holds.
#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

// Vectors of GCC and Clang, for every processor.
using Int32x4 [[gnu::vector_size(16)]] = int32_t;
using Int32x8 [[gnu::vector_size(32)]] = int32_t;
using Floats8 [[gnu::vector_size(32)]] = float;
using Floats4 [[gnu::vector_size(16)]] = float;
using Uint16x8 [[gnu::vector_size(16)]] = uint16_t;
using Sums [[gnu::vector_size(4 * kLanes)]] = int32_t;
using Shares [[gnu::vector_size(4 * kLanes)]] = float;
using ControlPoints [[gnu::vector_size(2 * kLanes)]] = int16_t;
// As many control points as a register holds, and their weights.
using WholeControlPoints [[gnu::vector_size(4 * kLanes)]] = int16_t;
using WholeWeights [[gnu::vector_size(4 * kLanes)]] = uint16_t;

constexpr int kSide = Tile::kSide;
template <typename Sum>
constexpr int kStride = SumBlock<Sum>::kStride;
constexpr int kRowsPerGroup = RowGroups::kRows;
// Of all blocks.
constexpr int kBlockRows = SumBlock<int32_t>::kRows;
constexpr int kBlockShift = 7;
static_assert(kBlockRows == 1 << kBlockShift);

// Eight sums, or four of faces.
template <typename Sum>
struct RowOf;
template <>
struct RowOf<int32_t> {
  using Type = Int32x8;
};
template <>
struct RowOf<uint16_t> {
  using Type = Uint16x8;
};
template <>
struct RowOf<FaceSum> {
  using Type = Int32x8;
};
template <typename Sum>
using Row = typename RowOf<Sum>::Type;

template <typename Vector>
Vector Load(const void* from) {
  Vector vector;
  __builtin_memcpy(&vector, from, sizeof vector);
  return vector;
}

template <typename Vector>
void Store(Vector vector, void* to) {
  __builtin_memcpy(to, &vector, sizeof vector);
}

template <typename Vector>
[[gnu::always_inline]] inline Vector Plus(Vector a, Vector b) {
  return a + b;
}
// Weights in 16 bits saturate.
[[gnu::always_inline]] inline Uint16x8 Plus(Uint16x8 a, Uint16x8 b) {
#ifdef __SSE2__
  return reinterpret_cast<Uint16x8>(
      _mm_adds_epu16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
#else
  const Uint16x8 sum = a + b;
  return sum < a ? ~Uint16x8{} : sum;
#endif
}

template <typename Vector>
void AddTo(Vector vector, void* to) {
  Store(Plus(Load<Vector>(to), vector), to);
}

// What the compiler makes of the plain expressions for the following is slow or, in parts, scalar.
bool IsZero(Int32x4 v) {
#ifdef __SSE2__
  const __m128i is_zero = _mm_cmpeq_epi32(reinterpret_cast<__m128i>(v), _mm_setzero_si128());
  return _mm_movemask_epi8(is_zero) == 0xffff;
#else
  return (v[0] | v[1] | v[2] | v[3]) == 0;
#endif
}
bool IsZero(Uint16x8 v) { return IsZero(reinterpret_cast<Int32x4>(v)); }
bool IsZero(Int32x8 v) {
#ifdef __AVX2__
  const auto whole = reinterpret_cast<__m256i>(v);
  return _mm256_testz_si256(whole, whole) != 0;
#else
  return IsZero(__builtin_shufflevector(v, v, 0, 1, 2, 3) |
                __builtin_shufflevector(v, v, 4, 5, 6, 7));
#endif
}
#ifdef __AVX512F__
bool IsZero(Sums v) {
  const auto whole = reinterpret_cast<__m512i>(v);
  return _mm512_test_epi32_mask(whole, whole) == 0;
}
#endif
Sums Widen(ControlPoints v) {
#if defined(__SSE2__) && !defined(__AVX2__)
  const __m128i low = _mm_cvtsi64_si128(reinterpret_cast<int64_t>(v));
  return reinterpret_cast<Sums>(_mm_srai_epi32(_mm_unpacklo_epi16(low, low), 16));
#else
  return __builtin_convertvector(v, Sums);
#endif
}

ControlPoints Narrow(Sums v) {
#if defined(__SSE2__) && !defined(__AVX2__)
  const auto whole = reinterpret_cast<__m128i>(v);
  return reinterpret_cast<ControlPoints>(_mm_cvtsi128_si64(_mm_packs_epi32(whole, whole)));
#elif defined(__AVX2__) && !defined(__AVX512F__)
  const auto whole = reinterpret_cast<__m256i>(v);
  const __m256i packed = _mm256_permute4x64_epi64(_mm256_packs_epi32(whole, whole), 0x08);
  return reinterpret_cast<ControlPoints>(_mm256_castsi256_si128(packed));
#else
  return __builtin_convertvector(v, ControlPoints);
#endif
}

// Takes pairs apart.
[[gnu::always_inline]] inline void Split(Sums a, Sums b, Sums& first, Sums& second) {
#if defined(__AVX512F__)
  first = __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
  second = __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
#elif defined(__AVX2__)
  first = __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14);
  second = __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15);
#else
  first = __builtin_shufflevector(a, b, 0, 2, 4, 6);
  second = __builtin_shufflevector(a, b, 1, 3, 5, 7);
#endif
}

[[gnu::always_inline]] inline WholeControlPoints Join(ControlPoints a, ControlPoints b) {
#if defined(__AVX512F__)
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17,
                                 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31);
#elif defined(__AVX2__)
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
#else
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
#endif
}

int32_t Least(int32_t a, int32_t b, int32_t c) {
  const int32_t least = a < b ? a : b;
  return least < c ? least : c;
}

// The groups that a range of rows lies in.
uint32_t GroupsOf(int32_t first_row, int32_t last_row) {
  return (2u << (last_row / kRowsPerGroup)) - (1u << (first_row / kRowsPerGroup));
}

Doubles4 Abs(Doubles4 x) { return x < 0 ? -x : x; }

Doubles4 SquareRoot(Doubles4 x) {
#if defined(__AVX__)
  return reinterpret_cast<Doubles4>(_mm256_sqrt_pd(reinterpret_cast<__m256d>(x)));
#else
  for (int k = 0; k < 4; ++k) x[k] = __builtin_sqrt(x[k]);
  return x;
#endif
}

// Exchanges rows and columns.
[[gnu::always_inline]] inline void Transpose(Doubles4 (&r)[4]) {
  const Doubles4 low01 = __builtin_shufflevector(r[0], r[1], 0, 4, 2, 6);
  const Doubles4 high01 = __builtin_shufflevector(r[0], r[1], 1, 5, 3, 7);
  const Doubles4 low23 = __builtin_shufflevector(r[2], r[3], 0, 4, 2, 6);
  const Doubles4 high23 = __builtin_shufflevector(r[2], r[3], 1, 5, 3, 7);
  r[0] = __builtin_shufflevector(low01, low23, 0, 1, 4, 5);
  r[1] = __builtin_shufflevector(high01, high23, 0, 1, 4, 5);
  r[2] = __builtin_shufflevector(low01, low23, 2, 3, 6, 7);
  r[3] = __builtin_shufflevector(high01, high23, 2, 3, 6, 7);
}

// Likewise: lays the elements of the one half of the rows between those of the other, twice.
[[gnu::always_inline]] inline void Transpose(Integers4 (&r)[4]) {
  for (int step = 0; step < 2; ++step) {
    const Integers4 t[4] = {__builtin_shufflevector(r[0], r[2], 0, 4, 1, 5),
                            __builtin_shufflevector(r[0], r[2], 2, 6, 3, 7),
                            __builtin_shufflevector(r[1], r[3], 0, 4, 1, 5),
                            __builtin_shufflevector(r[1], r[3], 2, 6, 3, 7)};
    for (int k = 0; k < 4; ++k) r[k] = t[k];
  }
}

// Four beams.
struct PlacedFour {
  Doubles4 x;  // in knots
  Doubles4 y;
  Doubles4 dx;
  Doubles4 dy;
  Doubles4 range;
};

[[gnu::always_inline]] inline PlacedFour LoadPlaced(const BeamMemory* beams, double knots_per_m) {
  static_assert(offsetof(BeamMemory, direction_world) == 2 * sizeof(double));
  Doubles4 beam[4];  // origin and direction
  Doubles4 range_m;
  for (int k = 0; k < 4; ++k) {
    beam[k] = Load<Doubles4>(&beams[k]);
    range_m[k] = beams[k].range_m;
  }
  Transpose(beam);
  return {beam[0] * knots_per_m, beam[1] * knots_per_m, beam[2], beam[3], range_m * knots_per_m};
}

// Of the four beams before.
struct HitsBefore {
  Doubles4 x;
  Doubles4 y;
  Doubles4 spacing;
};

// Of four beams and the one after them.
[[gnu::always_inline]] inline HitsBefore SetFourHits(const BeamMemory* beams, double knots_per_m,
                                                     const HitsBefore& before, const Hits& hits,
                                                     size_t n) {
  const PlacedFour four = LoadPlaced(beams, knots_per_m);
  const Doubles4 last = Load<Doubles4>(&beams[4]);
  const Doubles4 next_dx = __builtin_shufflevector(four.dx, last, 1, 2, 3, 6);
  const Doubles4 next_dy = __builtin_shufflevector(four.dy, last, 1, 2, 3, 7);
  const Doubles4 x = four.x + four.range * four.dx;
  const Doubles4 y = four.y + four.range * four.dy;
  const Doubles4 spacing = four.range * Abs(four.dx * next_dy - four.dy * next_dx);
  Store(x, hits.x + n);
  Store(y, hits.y + n);
  Store(spacing, hits.spacing + n);

  // The same to either side as far as the hits lie apart, one at least.
  const Doubles4 most = Doubles4{} + (Hits::kMostAside - 1);
  const Doubles4 aside = Hits::kHalfChordKnots / spacing;
  Store(__builtin_convertvector(aside < most ? aside : most, Integers4) + 1, hits.aside + n);

  const Doubles4 x_step = x - __builtin_shufflevector(before.x, x, 3, 4, 5, 6);
  const Doubles4 y_step = y - __builtin_shufflevector(before.y, y, 3, 4, 5, 6);
  const Doubles4 oblique =
      Hits::kMostObliqueGap * __builtin_shufflevector(before.spacing, spacing, 3, 4, 5, 6);
  const Doubles4 near = Doubles4{} + Hits::kNearKnots;
  const Doubles4 gap = oblique < near ? near : oblique;
  const Longs4 is_near = x_step * x_step + y_step * y_step < gap * gap;
  Integers4 hit;
  for (int k = 0; k < 4; ++k) hit[k] = beams[k].hit ? -1 : 0;
  Store(__builtin_convertvector(is_near, Integers4) & hit, hits.is_beside + n);
  return {x, y, spacing};
}

void SetHits(const BeamMemory* beams, size_t count, double knots_per_m, const Hits& hits) {
  HitsBefore before{};
  size_t n = 0;
  for (; n + 5 <= count; n += 4) before = SetFourHits(beams + n, knots_per_m, before, hits, n);
  for (; n < count; n += 4) {
    BeamMemory last[5] = {};
    for (size_t k = 0; k < 5 && n + k < count; ++k) last[k] = beams[n + k];
    // The last beam's spacing is that to the one before.
    if (count < n + 5) last[count - n] = beams[count > 1 ? count - 2 : 0];
    before = SetFourHits(last, knots_per_m, before, hits, n);
  }
}

void SetFourFaces(const BeamMemory* beams, const Chord* chords, Face* faces) {
  constexpr double kBefore = SignedDistance::kFrontKnots;
  static_assert(offsetof(Chord, behind_knots) == 2 * sizeof(double));
  static_assert(offsetof(Face, behind_knots) == 3 * sizeof(double));
  Doubles4 chord[4];
  Doubles4 beam[4];
  Integers4 weight;
  for (int k = 0; k < 4; ++k) {
    chord[k] = Load<Doubles4>(&chords[k]);
    beam[k] = Load<Doubles4>(&beams[k]);
    weight[k] = chords[k].weight;
  }
  Transpose(chord);
  Transpose(beam);
  const Doubles4 dx = beam[2];
  const Doubles4 dy = beam[3];
  const Doubles4 squared_length = chord[0] * chord[0] + chord[1] * chord[1];
  const Longs4 is_lone = squared_length < Face::kLeastChordKnots * Face::kLeastChordKnots;
  const Doubles4 scale = 1 / SquareRoot(is_lone ? Doubles4{} + 1 : squared_length);
  const Doubles4 x = -chord[1] * scale;
  const Doubles4 y = chord[0] * scale;
  const Doubles4 cosine = x * dx + y * dy;
  const Longs4 is_away = cosine < 0;
  const Doubles4 least = Doubles4{} + Face::kLeastCosine;
  const Doubles4 stretch = 1 / (Abs(cosine) < least ? least : Abs(cosine));
  const Longs4 is_face = __builtin_convertvector(weight != 0, Longs4);
  // Control points one knot from the plane in front, and a row more.
  const Doubles4 before = (is_lone ? Doubles4{} + 1 : stretch) * kBefore + 1;
  Doubles4 face[4] = {is_lone   ? dx
                      : is_away ? -x
                                : x,
                      is_lone   ? dy
                      : is_away ? -y
                                : y,
                      is_face ? before : Doubles4{}, chord[2]};
  Transpose(face);
  for (int k = 0; k < 4; ++k) {
    Store(face[k], &faces[k]);
    faces[k].weight = weight[k];
  }
}

void SetFaces(const BeamMemory* beams, const Chord* chords, size_t count, Face* faces) {
  size_t n = 0;
  for (; n + 4 <= count; n += 4) SetFourFaces(beams + n, chords + n, faces + n);
  if (n == count) return;
  BeamMemory last[4] = {};
  Chord last_chords[4] = {};
  Face last_faces[4];
  __builtin_memcpy(last, beams + n, (count - n) * sizeof *beams);
  __builtin_memcpy(last_chords, chords + n, (count - n) * sizeof *chords);
  SetFourFaces(last, last_chords, last_faces);
  __builtin_memcpy(faces + n, last_faces, (count - n) * sizeof *faces);
}

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
  const Longs4 is_steep = Abs(dy) >= Abs(dx);
  return {is_steep,           is_steep ? y : x,   is_steep ? x : y,
          is_steep ? dy : dx, is_steep ? dx : dy, range};
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
  const Doubles4 first_column = slope_index < 0 ? Doubles4{} + Table::FirstColumn(true)
                                                : Doubles4{} + Table::FirstColumn(false);
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
  const Longs4 has_length = length_or_less > 0;
  const Doubles4 length = has_length ? length_or_less : Doubles4{};
  const Doubles4 slope = beams.d_across / (has_length ? beams.d_along : Doubles4{} + 1);
  const Doubles4 end = beams.along + length * beams.d_along;
  const Doubles4 first_row = Floor(end < beams.along ? end : beams.along) + 1;
  const Doubles4 last_row = Floor(end < beams.along ? beams.along : end);
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
  const Doubles4 length = length_or_less > 0 ? length_or_less : Doubles4{};
  const Longs4 is_forward = beams.d_along > 0;
  const Doubles4 slope = beams.d_across / (beams.range > 0 ? beams.d_along : Doubles4{} + 1);

  const Doubles4 begin_row = Floor(beams.along);
  const Doubles4 cut_row = Floor(beams.along + length * beams.d_along);
  const Doubles4 end = beams.along + (beams.range + behind) * beams.d_along;
  const Doubles4 end_row = Floor(end);
  const FourLines free = SetFour(beams, slope, (is_forward ? begin_row : cut_row) + 1,
                                 is_forward ? cut_row : begin_row);
  const Doubles4 first_row = (is_forward ? cut_row : end_row) + 1;
  const FourLines face = SetFour(beams, slope, first_row, is_forward ? end_row : cut_row);

  const Doubles4 per_row_behind = 1 / (behind * beams.d_along);
  const Doubles4 part = (end - first_row) * per_row_behind;

  // How far the first control point lies behind the face.
  constexpr double kSharePerKnot =
      SignedDistance::kWholeShare / (SignedDistance::kFrontKnots + SignedDistance::kBackKnots);
  const Doubles4 per_row = (beams.is_steep ? normal_y : normal_x) * kSharePerKnot;
  const Doubles4 per_column = (beams.is_steep ? normal_x : normal_y) * kSharePerKnot;
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

// So many rows from column x of a block on lie in pairs that begin in it.
[[gnu::always_inline]] inline int32_t RowsInBlock(uint32_t x, uint32_t width,
                                                  int32_t columns_per_row) {
  if (columns_per_row == 0) return kBlockRows;
  const uint32_t way = columns_per_row > 0 ? width - 1 - x : x;
  const auto per_row =
      static_cast<uint32_t>(columns_per_row > 0 ? columns_per_row : -columns_per_row);
  return static_cast<int32_t>(way / per_row + 2) & ~1;
}

template <typename Sum>
void AddLine(const FreeLine& line, const Sum* table, SumPlane<Sum>& plane) {
  using Table = FreeLineTable<Sum>;
  using Block = SumBlock<Sum>;
  constexpr int kTileShift = FreeLine::kFractionBits + 5;
  constexpr int kWidthShift = kTileShift + Block::kAcrossBits;
  constexpr uint32_t kWidth = uint32_t{1} << kWidthShift;
  constexpr int kPhaseShift = FreeLine::kFractionBits - Table::kPhaseBits;
  constexpr uint32_t kLastColumn = (Table::kWidth - 1) << FreeLine::kFractionBits;
  const Sum* const row_pairs = table + ptrdiff_t{line.slope} * Table::kSumsPerSlope;
  const auto columns_per_pair = static_cast<uint32_t>(2 * line.columns_per_row);
  int64_t column = line.column;
  int32_t row = line.first_row;
  int32_t left = line.rows;
  while (left > 0) {
    Block* block = plane.At(static_cast<int32_t>(column >> kWidthShift), row >> kBlockShift);
    const int32_t row_in_block = row & (kBlockRows - 1);
    const uint32_t first_x = static_cast<uint32_t>(column) & (kWidth - 1);
    const int32_t rows =
        Least(left, kBlockRows - row_in_block, RowsInBlock(first_x, kWidth, line.columns_per_row));
    uint32_t x = first_x;
    Sum* sums = block->sums + row_in_block * kStride<Sum>;
    const auto add_pair = [&](Row<Sum> second_mask) {
      const uint32_t phase = (x >> kPhaseShift) & (Table::kPhases - 1);
      const Sum* const pair = row_pairs + phase * (2 * Table::kWidth);
      Sum* const place = sums + (x >> FreeLine::kFractionBits);
      AddTo(Load<Row<Sum>>(pair), place);
      AddTo(Load<Row<Sum>>(pair + Table::kWidth) & second_mask, place + kStride<Sum>);
    };
    for (int32_t n = (rows - 1) / 2; n > 0; --n) {
      add_pair(~Row<Sum>{});
      sums += 2 * kStride<Sum>;
      x += columns_per_pair;
    }
    // Without a branch, which could not be foretold, for the half of lines that end with a whole
    // pair.
    add_pair(Row<Sum>{} - static_cast<Sum>(1 - rows % 2));

    const uint32_t groups = GroupsOf(row_in_block, row_in_block + rows - 1);
    const auto first = static_cast<int32_t>((x < first_x ? x : first_x) >> kTileShift);
    const auto last =
        static_cast<int32_t>(((x < first_x ? first_x : x) + kLastColumn) >> kTileShift);
    const Int32x8 tile = {0, 1, 2, 3, 4, 5, 6, 7};
    static_assert(sizeof block->touched == sizeof tile);
    Store(Load<Int32x8>(block->touched) |
              ((tile >= first) & (tile <= last) & static_cast<int32_t>(groups)),
          block->touched);
    column += int64_t{line.columns_per_row} * rows;
    row += rows;
    left -= rows;
  }
}

template <typename Sum>
void AddLines(const FreeLine* lines, size_t count, const Sum* table, SumPlane<Sum>& plane) {
  for (size_t n = 0; n < count; ++n) AddLine(lines[n], table, plane);
}

void AddFace(const FaceLine& face, const int32_t* table, SumPlane<FaceSum>& plane) {
  constexpr int kPhaseShift = FreeLine::kFractionBits - FaceLineTable::kPhaseBits;
  constexpr float kWhole = SignedDistance::kWholeShare;
  constexpr int kPartBits = 5;
  const FreeLine& line = face.line;
  const int32_t* const rows = table + ptrdiff_t{line.slope} * FaceLineTable::kSumsPerSlope;
  // The line begins at the first column of a free one, one less where the slope is negative.
  constexpr int kSkipped = FaceLineTable::kFirstColumn - FreeLineTable<int32_t>::FirstColumn(false);
  static_assert(FreeLineTable<int32_t>::FirstColumn(false) ==
                FreeLineTable<int32_t>::FirstColumn(true) + 1);
  const int32_t skipped = kSkipped - ((line.slope - LineTable::kSlopesPerOne) >> 31);
  const Floats4 columns = static_cast<float>(skipped) + Floats4{0, 1, 2, 3};
  const Floats4 share_of_columns = columns * face.share_per_column;
  const auto first_cell = static_cast<int32_t>(line.column >> FreeLine::kFractionBits);
  const auto fraction =
      static_cast<int32_t>(line.column & ((int64_t{1} << FreeLine::kFractionBits) - 1));
  static_assert(FaceLine::kMostRows <= 8);
  const Int32x8 n = {0, 1, 2, 3, 4, 5, 6, 7};
  const Floats8 n_float = __builtin_convertvector(n, Floats8);
  const Int32x8 column = fraction + n * line.columns_per_row;
  const Int32x8 cells = column >> FreeLine::kFractionBits;
  const Floats8 most_part = face.part + n_float * face.part_per_row;
  const Floats8 part = most_part < 1 ? most_part : Floats8{} + 1;
  int32_t cell_of_row[8];
  int32_t phase_of_row[8];
  int32_t weight_of_row[8];
  float share_of_row[8];
  Store(first_cell + skipped + cells, cell_of_row);
  Store((column >> kPhaseShift) & (LineTable::kPhases - 1), phase_of_row);
  Store(face.weight * __builtin_convertvector(part * part * (1 << kPartBits), Int32x8),
        weight_of_row);
  Store(face.share + __builtin_convertvector(cells, Floats8) * face.share_per_column +
            n_float * face.share_per_row,
        share_of_row);
  SumBlock<FaceSum>* block = nullptr;
  for (int32_t k = 0; k < line.rows; ++k) {
    const int32_t row = line.first_row + k;
    const int32_t cell = cell_of_row[k];
    if (block == nullptr || block->column != cell >> 5 || block->row != row >> kBlockShift) {
      block = plane.At(cell >> 5, row >> kBlockShift);
    }
    const Integers4 weight =
        (Load<Integers4>(rows + phase_of_row[k] * FaceLineTable::kWidth) * weight_of_row[k]) >>
        kPartBits;
    Floats4 share = share_of_row[k] + share_of_columns;
    share = share < 0 ? Floats4{} : share;
    share = share > kWhole ? Floats4{} + kWhole : share;
    static_assert(SignedDistance::kWholeShare == 1 << 8);
    const Integers4 occupied = (weight * __builtin_convertvector(share, Integers4)) >> 8;
    const int32_t row_in_block = row & (kBlockRows - 1);
    const int32_t place = cell & (kSide - 1);
    AddTo(__builtin_shufflevector(weight, occupied, 0, 4, 1, 5, 2, 6, 3, 7),
          block->sums + row_in_block * kStride<FaceSum> + place);
    const uint32_t group = GroupsOf(row_in_block, row_in_block);
    const int32_t in_apron = (kSide - FaceLineTable::kWidth - place) >> 31;
    block->touched[0] |= group;
    block->touched[1] |= group & static_cast<uint32_t>(in_apron);
  }
}

void AddFaces(const FaceLine* faces, size_t count, const int32_t* table, SumPlane<FaceSum>& plane) {
  for (size_t n = 0; n < count; ++n) AddFace(faces[n], table, plane);
}

void AddSamples(const PointSample* samples, size_t count, SumPlane<int32_t>& plane) {
  constexpr int kHalf = 1 << (PointSample::kWeightBits - 1);
  for (size_t n = 0; n < count; ++n) {
    const PointSample& sample = samples[n];
    const int32_t tx = sample.i >> 5;
    const auto x_weights = Load<Int32x4>(sample.x_weights);
    SumBlock<int32_t>* block = plane.At(tx, sample.j >> kBlockShift);
    for (int k = 0; k < 4; ++k) {
      const int32_t row = (sample.j + k) & (kBlockRows - 1);
      if (row == 0 && k > 0) block = plane.At(tx, (sample.j + k) >> kBlockShift);
      for (uint32_t& groups : block->touched) groups |= GroupsOf(row, row);
      AddTo((x_weights * sample.y_weights[k] + kHalf) >> PointSample::kWeightBits,
            block->sums + row * kStride<int32_t> + (sample.i & (kSide - 1)));
    }
  }
}

// Of faces, four sums are all that they reach.
template <typename Sum>
void MoveApron(Sum* apron, uint32_t groups, Sum* to) {
  for (int row = 0; row < kSide; ++row, apron += kStride<Sum>, to += kStride<Sum>) {
    if ((groups >> (row / kRowsPerGroup) & 1) == 0) continue;
    AddTo(Load<Row<Sum>>(apron), to);
    Store(Row<Sum>{}, apron);
  }
}

// Likewise, three times.
template <typename Vector>
[[gnu::always_inline]] inline void Transpose(Vector (&r)[8]) {
  for (int step = 0; step < 3; ++step) {
    Vector t[8];
    for (int k = 0; k < 4; ++k) {
      t[2 * k] = __builtin_shufflevector(r[k], r[k + 4], 0, 8, 1, 9, 2, 10, 3, 11);
      t[2 * k + 1] = __builtin_shufflevector(r[k], r[k + 4], 4, 12, 5, 13, 6, 14, 7, 15);
    }
    for (int k = 0; k < 8; ++k) r[k] = t[k];
  }
}

template <typename Sum>
void MoveTransposed(Sum* from, uint32_t groups, Sum* to) {
  constexpr int kGroupsOfEight = (1 << (8 / kRowsPerGroup)) - 1;
  for (int y = 0; y < kSide; y += 8) {
    if ((groups >> (y / kRowsPerGroup) & kGroupsOfEight) == 0) continue;
    for (int x = 0; x < kSide; x += 8) {
      Sum* source = from + y * kStride<Sum> + x;
      Row<Sum> rows[8];
      for (int k = 0; k < 8; ++k) rows[k] = Load<Row<Sum>>(source + k * kStride<Sum>);
      if (IsZero((rows[0] | rows[1]) | (rows[2] | rows[3]) | (rows[4] | rows[5]) |
                 (rows[6] | rows[7]))) {
        continue;
      }
      for (int k = 0; k < 8; ++k) Store(Row<Sum>{}, source + k * kStride<Sum>);
      Transpose(rows);
      for (int k = 0; k < 8; ++k) AddTo(rows[k], to + (x + k) * kStride<Sum> + y);
    }
  }
}

template <>
void MoveTransposed(FaceSum* from, uint32_t groups, FaceSum* to) {
  for (int y = 0; y < kSide; y += 4) {
    if ((groups >> (y / kRowsPerGroup) & 1) == 0) continue;
    for (int x = 0; x < kSide; x += 4) {
      FaceSum* source = from + y * kStride<FaceSum> + x;
      Int32x8 r[4];
      for (int k = 0; k < 4; ++k) r[k] = Load<Int32x8>(source + k * kStride<FaceSum>);
      if (IsZero((r[0] | r[1]) | (r[2] | r[3]))) continue;
      for (int k = 0; k < 4; ++k) Store(Int32x8{}, source + k * kStride<FaceSum>);
      for (int k = 0; k < 4; k += 2) {
        const Int32x8 even = __builtin_shufflevector(r[k], r[k + 1], 0, 1, 8, 9, 4, 5, 12, 13);
        r[k + 1] = __builtin_shufflevector(r[k], r[k + 1], 2, 3, 10, 11, 6, 7, 14, 15);
        r[k] = even;
      }
      for (int k = 0; k < 2; ++k) {
        AddTo(__builtin_shufflevector(r[k], r[k + 2], 0, 1, 2, 3, 8, 9, 10, 11),
              to + (x + k) * kStride<FaceSum> + y);
        AddTo(__builtin_shufflevector(r[k], r[k + 2], 4, 5, 6, 7, 12, 13, 14, 15),
              to + (x + k + 2) * kStride<FaceSum> + y);
      }
    }
  }
}

Sums Rounded(Sums sums) {
  constexpr int32_t kHalf = 1 << (kSumFractionBits - 1);
  const Sums odd = (sums >> kSumFractionBits) & 1;
  return (sums + (kHalf - 1) + odd) >> kSumFractionBits;
}

bool HasChange(const int32_t* sums) {
  for (int row = 0; row < kSide; ++row) {
    for (int k = 0; k < kSide; k += kLanes) {
      if (!IsZero(Rounded(Load<Sums>(sums + row * kStride<int32_t> + k)))) return true;
    }
  }
  return false;
}

Sums Clamp(Sums v, ControlLimits limits) {
  const Sums least = Sums{} + limits.min;
  const Sums most = Sums{} + limits.max;
  v = v < least ? least : v;
  return v > most ? most : v;
}

// Without a branch for sums that are 0: where they begin and end cannot be foretold.
void Commit(int32_t* sums, ControlLimits limits, ControlLimits scan_limits,
            ControlPoint* control_points) {
  for (int row = 0; row < kSide; ++row) {
    for (int k = 0; k < kSide; k += kLanes) {
      int32_t* const some = sums + row * kStride<int32_t> + k;
      const Sums change = Rounded(Load<Sums>(some));
      Store(Sums{}, some);
      const Sums old = Widen(Load<ControlPoints>(control_points));
      Sums result = Clamp(old + Clamp(change, scan_limits), limits);
      result = result == 0 ? Sums{} + 1 : result;  // what was touched stays known
      result = change == 0 ? old : result;
      Store(Narrow(result), control_points);
      control_points += kLanes;
    }
  }
}

// (a - b) * c / 2^15, rounded, where the difference saturates.
[[gnu::always_inline]] inline WholeControlPoints Share(WholeControlPoints a, WholeControlPoints b,
                                                       WholeControlPoints c) {
#if defined(__AVX512BW__)
  return reinterpret_cast<WholeControlPoints>(_mm512_mulhrs_epi16(
      _mm512_subs_epi16(reinterpret_cast<__m512i>(a), reinterpret_cast<__m512i>(b)),
      reinterpret_cast<__m512i>(c)));
#elif defined(__AVX2__)
  return reinterpret_cast<WholeControlPoints>(_mm256_mulhrs_epi16(
      _mm256_subs_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)),
      reinterpret_cast<__m256i>(c)));
#else
  using Wide [[gnu::vector_size(8 * kLanes)]] = int32_t;
  const Wide most = Wide{} + 32767;
  Wide difference = __builtin_convertvector(a, Wide) - __builtin_convertvector(b, Wide);
  difference = difference > most ? most : difference;
  difference = difference < ~most ? ~most : difference;
  return __builtin_convertvector((difference * __builtin_convertvector(c, Wide) + (1 << 14)) >> 15,
                                 WholeControlPoints);
#endif
}

// Of as many control points as a register holds.
struct Votes {
  WholeControlPoints distance;
  WholeControlPoints weight;  // up to kMostWeight
};

[[gnu::always_inline]] inline Votes VotesOfFree(const uint16_t* free) {
  const auto weight = Load<WholeWeights>(free);
  const WholeWeights most = WholeWeights{} + SignedDistance::kMostWeight;
  return {WholeControlPoints{} + SignedDistance::kFree,
          reinterpret_cast<WholeControlPoints>(weight < most ? weight : most)};
}

// Moves the sums of faces. Those of free space stay.
[[gnu::always_inline]] inline Votes TakeVotes(const uint16_t* free, FaceSum* faces) {
  using HalfWeights [[gnu::vector_size(2 * kLanes)]] = uint16_t;
  constexpr float kRange = SignedDistance::kOccupied - SignedDistance::kFree;
  constexpr int kMost = SignedDistance::kMostWeight;
  ControlPoints distances[2];
  ControlPoints weights[2];
  for (int half = 0; half < 2; ++half) {
    FaceSum* const some = faces + half * kLanes;
    const auto first = Load<Sums>(some);
    const auto second = Load<Sums>(some + kLanes / 2);
    const auto free_weight = Load<HalfWeights>(free + half * kLanes);
    if (IsZero(first | second)) {
      distances[half] = ControlPoints{} + SignedDistance::kFree;
      weights[half] = reinterpret_cast<ControlPoints>(free_weight < kMost ? free_weight
                                                                          : HalfWeights{} + kMost);
      continue;
    }
    Store(Sums{}, some);
    Store(Sums{}, some + kLanes / 2);
    Sums weight;
    Sums occupied;
    Split(first, second, weight, occupied);
    weight += __builtin_convertvector(free_weight, Sums);
    const Shares share = __builtin_convertvector(occupied, Shares) /
                         __builtin_convertvector(weight > 0 ? weight : Sums{} + 1, Shares);
    distances[half] =
        Narrow(SignedDistance::kFree + __builtin_convertvector(share * kRange + 0.5F, Sums));
    weights[half] = Narrow(weight < kMost ? weight : Sums{} + kMost);
  }
  return {Join(distances[0], distances[1]), Join(weights[0], weights[1])};
}

// Control points moved to their signed distance as far as the weight says; those without weight
// stay.
[[gnu::always_inline]] inline WholeControlPoints Averaged(const Votes& votes,
                                                          WholeControlPoints old,
                                                          ControlLimits limits) {
  constexpr int kMoreBits = 15 - SignedDistance::kForgetBits;
  static_assert(SignedDistance::kMostWeight << kMoreBits < 1 << 15);
  const WholeControlPoints least = WholeControlPoints{} + limits.min;
  const WholeControlPoints most = WholeControlPoints{} + limits.max;
  const WholeControlPoints moved = old + Share(votes.distance, old, votes.weight << kMoreBits);
  WholeControlPoints result = old == 0 ? votes.distance : moved;
  result = result < least ? least : result;
  result = result > most ? most : result;
  result = result == 0 ? WholeControlPoints{} + 1 : result;  // what was touched stays known
  return votes.weight == 0 ? old : result;
}

bool CommitDistances(uint16_t* free, uint32_t groups, FaceSum* faces, uint32_t face_groups,
                     ControlLimits limits, const ControlPoint* from, ControlPoint* to) {
  constexpr int kWhole = 2 * kLanes;
  WholeControlPoints is_changed{};
  for (int row = 0; row < kSide; ++row, from += kSide, to += kSide) {
    const int group = row / kRowsPerGroup;
    if ((groups >> group & 1) == 0) {
      __builtin_memcpy(to, from, kSide * sizeof *to);
      continue;
    }
    for (int k = 0; k < kSide; k += kWhole) {
      uint16_t* const some = free + row * kStride<uint16_t> + k;
      const bool has_faces = (face_groups >> group & 1) != 0;
      const Votes votes =
          has_faces ? TakeVotes(some, faces + row * kStride<FaceSum> + k) : VotesOfFree(some);
      Store(WholeWeights{}, some);
      const auto old = Load<WholeControlPoints>(from + k);
      const WholeControlPoints result = Averaged(votes, old, limits);
      is_changed |= result ^ old;
      Store(result, to + k);
    }
  }
  return !IsZero(reinterpret_cast<Sums>(is_changed));
}

#define SPLINEMAP_STRING(x) #x
#define SPLINEMAP_NAME(x) SPLINEMAP_STRING(x)

}  // namespace

extern const ScanKernel kScanKernel;
const ScanKernel kScanKernel{SPLINEMAP_NAME(SPLINEMAP_KERNEL),
                             &SetLines,
                             &SetHits,
                             &SetFaces,
                             &SetFaceLines,
                             &AddLines<int32_t>,
                             &AddLines<uint16_t>,
                             &AddFaces,
                             &AddSamples,
                             {&MoveApron<int32_t>, &MoveTransposed<int32_t>},
                             {&MoveApron<uint16_t>, &MoveTransposed<uint16_t>},
                             {&MoveApron<FaceSum>, &MoveTransposed<FaceSum>},
                             &HasChange,
                             &Commit,
                             &CommitDistances};

}  // namespace splinemap::SPLINEMAP_KERNEL
