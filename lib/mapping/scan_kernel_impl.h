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
using Sums [[gnu::vector_size(4 * kLanes)]] = int32_t;
using Shares [[gnu::vector_size(4 * kLanes)]] = float;
using ControlPoints [[gnu::vector_size(2 * kLanes)]] = int16_t;

constexpr int kSide = Tile::kSide;
constexpr int kStride = SumBlock::kStride;
constexpr int kBlockShift = 7;
static_assert(SumBlock::kRows == 1 << kBlockShift);

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
void AddTo(Vector vector, int32_t* to) {
  Store(Load<Vector>(to) + vector, to);
}

// What the compiler makes of the plain expressions for the following is slow or, in parts, scalar.
#if defined(__AVX2__)
bool IsZero(Int32x8 v) {
  const auto whole = reinterpret_cast<__m256i>(v);
  return _mm256_testz_si256(whole, whole) != 0;
}
#else
bool IsZero(Int32x4 v) {
#ifdef __SSE2__
  const __m128i is_zero = _mm_cmpeq_epi32(reinterpret_cast<__m128i>(v), _mm_setzero_si128());
  return _mm_movemask_epi8(is_zero) == 0xffff;
#else
  return (v[0] | v[1] | v[2] | v[3]) == 0;
#endif
}
bool IsZero(Int32x8 v) {
  return IsZero(__builtin_shufflevector(v, v, 0, 1, 2, 3) |
                __builtin_shufflevector(v, v, 4, 5, 6, 7));
}
#endif
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

void Touch(SumBlock& block, int32_t first_row, int32_t last_row) {
  block.touched |= (2u << (last_row / kSide)) - (1u << (first_row / kSide));
}

Doubles4 Abs(Doubles4 x) { return x < 0 ? -x : x; }

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
  static_assert(offsetof(BeamMemory, direction_world) == 2 * sizeof(double));
  Doubles4 beam[4];  // origin and direction
  Doubles4 range_m;
  for (int k = 0; k < 4; ++k) {
    beam[k] = Load<Doubles4>(&beams[k]);
    range_m[k] = beams[k].range_m;
  }
  const Doubles4 xy01 = __builtin_shufflevector(beam[0], beam[1], 0, 4, 1, 5);
  const Doubles4 xy23 = __builtin_shufflevector(beam[2], beam[3], 0, 4, 1, 5);
  const Doubles4 uv01 = __builtin_shufflevector(beam[0], beam[1], 2, 6, 3, 7);
  const Doubles4 uv23 = __builtin_shufflevector(beam[2], beam[3], 2, 6, 3, 7);
  const Doubles4 x = __builtin_shufflevector(xy01, xy23, 0, 1, 4, 5) * knots_per_m;
  const Doubles4 y = __builtin_shufflevector(xy01, xy23, 2, 3, 6, 7) * knots_per_m;
  const Doubles4 dx = __builtin_shufflevector(uv01, uv23, 0, 1, 4, 5);
  const Doubles4 dy = __builtin_shufflevector(uv01, uv23, 2, 3, 6, 7);
  const Longs4 is_steep = Abs(dy) >= Abs(dx);
  return {is_steep,           is_steep ? y : x,   is_steep ? x : y,
          is_steep ? dy : dx, is_steep ? dx : dy, range_m * knots_per_m};
}

// Which columns the lines of four beams have in their first rows.
struct FourLines {
  Doubles4 cell;  // of the first control point touched
  Integers4 fraction;
  Integers4 columns_per_row;
  Integers4 slope;  // of the table
  Integers4 first_row;
  Integers4 rows;
};

[[gnu::always_inline]] inline FourLines SetFour(const FourBeams& beams, Doubles4 slope,
                                                Doubles4 first_row, Doubles4 last_row) {
  const Doubles4 slope_index = Floor(slope * FreeLineTable::kSlopesPerOne + 0.5);
  const Doubles4 first_column = slope_index < 0 ? Doubles4{} + FreeLineTable::FirstColumn(true)
                                                : Doubles4{} + FreeLineTable::FirstColumn(false);
  constexpr double kOne = int64_t{1} << FreeLine::kFractionBits;
  constexpr double kHalfPhase = 0.5 / FreeLine::kPhases;
  const Doubles4 column =
      beams.across + (first_row - beams.along) * slope + (first_column + kHalfPhase);
  const Doubles4 cell = Floor(column);
  return {cell,
          __builtin_convertvector(Floor((column - cell) * kOne + 0.5), Integers4),
          __builtin_convertvector(Floor(slope * kOne + 0.5), Integers4),
          __builtin_convertvector(slope_index, Integers4) + FreeLineTable::kSlopesPerOne,
          __builtin_convertvector(first_row, Integers4),
          __builtin_convertvector(last_row - first_row, Integers4) + 1};
}

[[gnu::always_inline]] inline void StoreLine(const FourLines& lines, int k,
                                             const int32_t* row_pairs, FreeLine& line) {
  line.column =
      (static_cast<int64_t>(lines.cell[k]) << FreeLine::kFractionBits) + lines.fraction[k];
  line.columns_per_row = lines.columns_per_row[k];
  line.first_row = lines.first_row[k];
  line.rows = lines.rows[k];
  line.row_pairs = row_pairs + ptrdiff_t{lines.slope[k]} * FreeLineTable::kSumsPerSlope;
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
    StoreLine(lines, k, model.row_pairs,
              is_steep ? steep_lines[counts.steep] : shallow_lines[counts.shallow]);
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

// Four beams cut in two: the rows of control points before their faces, and those that take part in
// them.
void SetFourFaceLines(const BeamMemory* memory, const Face* faces, const FreeLineModel& model,
                      FreeLine* steep_lines, FreeLine* shallow_lines, FaceLine* steep_faces,
                      FaceLine* shallow_faces, ScanKernel::FaceLineCounts& counts) {
  const FourBeams beams = LoadFour(memory, model.knots_per_m);
  Doubles4 normal_x;
  Doubles4 normal_y;
  Doubles4 before;
  Doubles4 behind;
  for (int k = 0; k < 4; ++k) {
    normal_x[k] = faces[k].normal[0];
    normal_y[k] = faces[k].normal[1];
    before[k] = faces[k].before_knots;
    behind[k] = faces[k].behind_knots;
  }
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

  for (int k = 0; k < 4; ++k) {
    const bool is_steep = beams.is_steep[k] != 0;
    StoreLine(free, k, model.row_pairs,
              is_steep ? steep_lines[counts.free.steep] : shallow_lines[counts.free.shallow]);
    const bool is_line = free.rows[k] > 0;
    counts.free.steep += is_line && is_steep ? 1 : 0;
    counts.free.shallow += is_line && !is_steep ? 1 : 0;

    FaceLine& line = is_steep ? steep_faces[counts.face.steep] : shallow_faces[counts.face.shallow];
    StoreLine(face, k, model.face_row_pairs, line.line);
    line.weight = faces[k].weight;
    line.share = static_cast<float>(share[k]);
    line.share_per_column = static_cast<float>(per_column[k]);
    line.share_per_row = static_cast<float>(per_row[k]);
    line.part = static_cast<float>(part[k]);
    line.part_per_row = static_cast<float>(-per_row_behind[k]);
    const bool is_face = memory[k].hit && face.rows[k] > 0;
    counts.face.steep += is_face && is_steep ? 1 : 0;
    counts.face.shallow += is_face && !is_steep ? 1 : 0;
  }
}

ScanKernel::FaceLineCounts SetFaceLines(const BeamMemory* beams, const Face* faces, size_t count,
                                        const FreeLineModel& model, FreeLine* steep_lines,
                                        FreeLine* shallow_lines, FaceLine* steep_faces,
                                        FaceLine* shallow_faces) {
  ScanKernel::FaceLineCounts counts;
  size_t n = 0;
  for (; n + 4 <= count; n += 4) {
    SetFourFaceLines(beams + n, faces + n, model, steep_lines, shallow_lines, steep_faces,
                     shallow_faces, counts);
  }
  if (n < count) {
    BeamMemory last[4] = {};  // a beam of zeros has no part
    Face last_faces[4] = {};
    __builtin_memcpy(last, beams + n, (count - n) * sizeof *beams);
    __builtin_memcpy(last_faces, faces + n, (count - n) * sizeof *faces);
    SetFourFaceLines(last, last_faces, model, steep_lines, shallow_lines, steep_faces,
                     shallow_faces, counts);
  }
  return counts;
}

void AddLine(const FreeLine& line, SumPlane& plane) {
  constexpr int kTileShift = FreeLine::kFractionBits + 5;
  constexpr uint32_t kTileWidth = uint32_t{1} << kTileShift;
  constexpr int kPhaseShift = FreeLine::kFractionBits - FreeLine::kPhaseBits;
  const int32_t* const row_pairs = line.row_pairs;
  const auto columns_per_row = static_cast<uint32_t>(line.columns_per_row);
  int64_t column = line.column;
  int32_t row = line.first_row;
  int32_t rows = line.rows;
  while (rows > 0) {
    SumBlock* block = plane.At(static_cast<int32_t>(column >> kTileShift), row >> kBlockShift);
    const int32_t row_in_block = row & (SumBlock::kRows - 1);
    const int32_t rows_left = SumBlock::kRows - row_in_block;
    int32_t* const begin = block->sums + row_in_block * kStride;
    const int32_t* const end = begin + (rows_left < rows ? rows_left : rows) * kStride;
    int32_t* sums = begin;
    uint32_t x = static_cast<uint32_t>(column) & (kTileWidth - 1);
    do {
      const uint32_t phase = (x >> kPhaseShift) & (FreeLine::kPhases - 1);
      const int32_t* const pair = row_pairs + phase * (2 * FreeLine::kWidth);
      int32_t* const place = sums + (x >> FreeLine::kFractionBits);
      AddTo(Load<Int32x8>(pair), place);
      sums += kStride;
      x += columns_per_row;
      if (sums == end) break;
      AddTo(Load<Int32x8>(pair + FreeLine::kWidth), place + kStride);
      sums += kStride;
      x += columns_per_row;
    } while (sums != end && x < kTileWidth);
    const auto done = static_cast<int32_t>((sums - begin) / kStride);
    Touch(*block, row_in_block, row_in_block + done - 1);
    row += done;
    rows -= done;
    column += int64_t{line.columns_per_row} * done;
  }
}

void AddLines(const FreeLine* lines, size_t count, SumPlane& plane) {
  for (size_t n = 0; n < count; ++n) AddLine(lines[n], plane);
}

void AddFace(const FaceLine& face, SumPlane& weights, SumPlane& occupied) {
  constexpr int kTileShift = FreeLine::kFractionBits + 5;
  constexpr int kPhaseShift = FreeLine::kFractionBits - FreeLine::kPhaseBits;
  constexpr float kWhole = SignedDistance::kWholeShare;
  constexpr int kPartBits = 5;
  constexpr int kWholePart = 1 << kPartBits;
  constexpr Floats8 kLanes8 = {0, 1, 2, 3, 4, 5, 6, 7};
  const FreeLine& line = face.line;
  const auto first_cell = static_cast<int32_t>(line.column >> FreeLine::kFractionBits);
  int64_t column = line.column;
  SumBlock* weight_block = nullptr;
  SumBlock* occupied_block = nullptr;
  for (int32_t n = 0; n < line.rows; ++n, column += line.columns_per_row) {
    const int32_t row = line.first_row + n;
    const auto tx = static_cast<int32_t>(column >> kTileShift);
    const int32_t block_row = row >> kBlockShift;
    if (weight_block == nullptr || weight_block->tx != tx || weight_block->row != block_row) {
      weight_block = weights.At(tx, block_row);
      occupied_block = occupied.At(tx, block_row);
    }
    const auto cell = static_cast<int32_t>(column >> FreeLine::kFractionBits);
    const auto phase = static_cast<uint32_t>(column >> kPhaseShift) & (FreeLine::kPhases - 1);
    const float part_of_row = face.part + static_cast<float>(n) * face.part_per_row;
    const int32_t part =
        part_of_row < 1 ? static_cast<int32_t>(part_of_row * part_of_row * kWholePart) : kWholePart;
    const auto weight =
        (Load<Int32x8>(line.row_pairs + phase * (2 * FreeLine::kWidth)) * (face.weight * part)) >>
        kPartBits;
    const float at_cell = face.share +
                          static_cast<float>(cell - first_cell) * face.share_per_column +
                          static_cast<float>(n) * face.share_per_row;
    Floats8 share = at_cell + kLanes8 * face.share_per_column;
    share = share < 0 ? Floats8{} : share;
    share = share > kWhole ? Floats8{} + kWhole : share;
    const auto whole_shares = __builtin_convertvector(share, Int32x8);
    const int32_t row_in_block = row & (SumBlock::kRows - 1);
    const int32_t place = row_in_block * kStride + (cell & (kSide - 1));
    AddTo(weight, weight_block->sums + place);
    static_assert(SignedDistance::kWholeShare == 1 << 8);
    AddTo((weight * whole_shares) >> 8, occupied_block->sums + place);
    Touch(*weight_block, row_in_block, row_in_block);
    Touch(*occupied_block, row_in_block, row_in_block);
  }
}

void AddFaces(const FaceLine* faces, size_t count, SumPlane& weights, SumPlane& occupied) {
  for (size_t n = 0; n < count; ++n) AddFace(faces[n], weights, occupied);
}

void AddSamples(const PointSample* samples, size_t count, SumPlane& plane) {
  constexpr int kHalf = 1 << (PointSample::kWeightBits - 1);
  for (size_t n = 0; n < count; ++n) {
    const PointSample& sample = samples[n];
    const int32_t tx = sample.i >> 5;
    const auto x_weights = Load<Int32x4>(sample.x_weights);
    SumBlock* block = plane.At(tx, sample.j >> kBlockShift);
    for (int k = 0; k < 4; ++k) {
      const int32_t row = (sample.j + k) & (SumBlock::kRows - 1);
      if (row == 0 && k > 0) block = plane.At(tx, (sample.j + k) >> kBlockShift);
      Touch(*block, row, row);
      AddTo((x_weights * sample.y_weights[k] + kHalf) >> PointSample::kWeightBits,
            block->sums + row * kStride + (sample.i & (kSide - 1)));
    }
  }
}

bool HasApron(const int32_t* sums) {
  Int32x8 any{};
  for (int row = 0; row < kSide; ++row) any |= Load<Int32x8>(sums + row * kStride + kSide);
  return !IsZero(any);
}

void MoveApron(int32_t* from, int32_t* to) {
  for (int row = 0; row < kSide; ++row) {
    int32_t* apron = from + row * kStride + kSide;
    AddTo(Load<Int32x8>(apron), to + row * kStride);
    Store(Int32x8{}, apron);
  }
}

// Exchanges rows and columns.
void Transpose(Int32x8 (&r)[8]) {
  Int32x8 t[8];
  for (int k = 0; k < 8; k += 2) {
    t[k] = __builtin_shufflevector(r[k], r[k + 1], 0, 8, 2, 10, 4, 12, 6, 14);
    t[k + 1] = __builtin_shufflevector(r[k], r[k + 1], 1, 9, 3, 11, 5, 13, 7, 15);
  }
  for (int k = 0; k < 8; k += 4) {
    for (int m = 0; m < 2; ++m) {
      r[k + m] = __builtin_shufflevector(t[k + m], t[k + m + 2], 0, 1, 8, 9, 4, 5, 12, 13);
      r[k + m + 2] = __builtin_shufflevector(t[k + m], t[k + m + 2], 2, 3, 10, 11, 6, 7, 14, 15);
    }
  }
  for (int k = 0; k < 4; ++k) {
    t[k] = __builtin_shufflevector(r[k], r[k + 4], 0, 1, 2, 3, 8, 9, 10, 11);
    t[k + 4] = __builtin_shufflevector(r[k], r[k + 4], 4, 5, 6, 7, 12, 13, 14, 15);
  }
  for (int k = 0; k < 8; ++k) r[k] = t[k];
}

void MoveTransposed(int32_t* from, int32_t* to) {
  for (int y = 0; y < kSide; y += 8) {
    for (int x = 0; x < kSide; x += 8) {
      int32_t* source = from + y * kStride + x;
      Int32x8 rows[8];
      for (int k = 0; k < 8; ++k) rows[k] = Load<Int32x8>(source + k * kStride);
      if (IsZero((rows[0] | rows[1]) | (rows[2] | rows[3]) | (rows[4] | rows[5]) |
                 (rows[6] | rows[7]))) {
        continue;
      }
      for (int k = 0; k < 8; ++k) Store(Int32x8{}, source + k * kStride);
      Transpose(rows);
      for (int k = 0; k < 8; ++k) AddTo(rows[k], to + (x + k) * kStride + y);
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
      if (!IsZero(Rounded(Load<Sums>(sums + row * kStride + k)))) return true;
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
      int32_t* const some = sums + row * kStride + k;
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

// Control points moved to their signed distance as far as the weight says; those without weight
// stay.
[[gnu::always_inline]] inline Sums Averaged(Sums distance, Sums weight, Sums old,
                                            ControlLimits limits) {
  constexpr int32_t kHalf = 1 << (SignedDistance::kForgetBits - 1);
  const Sums most = Sums{} + SignedDistance::kMostWeight;
  const Sums counted = weight < most ? weight : most;
  const Sums change = ((distance - old) * counted + kHalf) >> SignedDistance::kForgetBits;
  Sums result = Clamp(old == 0 ? distance : old + change, limits);
  result = result == 0 ? Sums{} + 1 : result;  // what was touched stays known
  return weight == 0 ? old : result;
}

[[gnu::always_inline]] inline Sums DistanceOf(Sums occupied, Sums weight) {
  constexpr float kRange = SignedDistance::kOccupied - SignedDistance::kFree;
  const Shares share = __builtin_convertvector(occupied, Shares) /
                       __builtin_convertvector(weight > 0 ? weight : Sums{} + 1, Shares);
  return SignedDistance::kFree + __builtin_convertvector(share * kRange + 0.5F, Sums);
}

bool CommitDistances(int32_t* weights, int32_t* occupied, ControlLimits limits,
                     const ControlPoint* from, ControlPoint* to) {
  __builtin_memcpy(to, from, Tile::kSize * sizeof *to);
  Sums is_changed{};
  for (int row = 0; row < kSide; ++row) {
    for (int k = 0; k < kSide; k += kLanes) {
      const int place = row * kStride + k;
      const Sums weight = Load<Sums>(weights + place);
      if (IsZero(weight)) continue;
      Store(Sums{}, weights + place);
      const Sums old = Widen(Load<ControlPoints>(from + row * kSide + k));
      const Sums part = occupied == nullptr ? Sums{} : Load<Sums>(occupied + place);
      Sums distance = Sums{} + SignedDistance::kFree;
      if (!IsZero(part)) {
        distance = DistanceOf(part, weight);
        Store(Sums{}, occupied + place);
      }
      const Sums result = Averaged(distance, weight, old, limits);
      is_changed |= result ^ old;
      Store(Narrow(result), to + row * kSide + k);
    }
  }
  return !IsZero(is_changed);
}

#define SPLINEMAP_STRING(x) #x
#define SPLINEMAP_NAME(x) SPLINEMAP_STRING(x)

}  // namespace

extern const ScanKernel kScanKernel;
const ScanKernel kScanKernel{SPLINEMAP_NAME(SPLINEMAP_KERNEL),
                             &SetLines,
                             &SetFaceLines,
                             &AddLines,
                             &AddFaces,
                             &AddSamples,
                             &HasApron,
                             &MoveApron,
                             &MoveTransposed,
                             &HasChange,
                             &Commit,
                             &CommitDistances};

}  // namespace splinemap::SPLINEMAP_KERNEL
