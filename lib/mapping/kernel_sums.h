#pragma once

// Lines, faces and samples added to sums. A part of scan_kernel_impl.h.

#include "lib/mapping/kernel_lanes.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// So many of `rows`, from column x of a block on, lie in pairs that begin in it.
[[gnu::always_inline]] inline uint32_t RowsInBlock(uint32_t x, uint32_t width, uint32_t rows,
                                                   int32_t columns_per_row) {
  const int64_t last = x + int64_t{columns_per_row} * ((rows - 1) & ~1u);
  if (last >= 0 && last < width) return rows;
  const uint32_t way = columns_per_row > 0 ? width - 1 - x : x;
  const auto per_row =
      static_cast<uint32_t>(columns_per_row > 0 ? columns_per_row : -columns_per_row);
  return (way / per_row + 2) & ~1u;
}

constexpr uint64_t kAllPairs = ~uint64_t{0};
static_assert(kBlockRows / 2 == 64);

// Of pairs of rows, from `first_row` of a block on, a bit for each that is not left out. The
// columns of the first begin at x.
[[gnu::always_inline]] inline uint64_t PairsToAdd(const NoMarks&, uint32_t, uint32_t pairs,
                                                  uint32_t, uint32_t) {
  return kAllPairs >> (64 - pairs);
}
[[gnu::always_inline]] inline uint64_t PairsToAdd(const SettledCells& settled, uint32_t first_row,
                                                  uint32_t pairs, uint32_t x,
                                                  uint32_t columns_per_pair) {
  constexpr int kCellShift = FreeLine::kFractionBits + SettledCells::kShift;
  const uint32_t* const of_pairs = settled.of_pairs[first_row % 2] + first_row / 2;
  uint64_t is_left_out = 0;
#ifdef __AVX2__
  using Words [[gnu::vector_size(32)]] = uint32_t;
  const Words numbers = {0, 1, 2, 3, 4, 5, 6, 7};
  Words columns = x + numbers * columns_per_pair;
  for (uint32_t n = 0; n < pairs; n += 8, columns += 8 * columns_per_pair) {
    const auto signs =
        reinterpret_cast<__m256>((Load<Words>(of_pairs + n) >> (columns >> kCellShift)) << 31);
    is_left_out |= uint64_t{static_cast<uint32_t>(_mm256_movemask_ps(signs))} << n;
  }
#elif defined(__SSE2__)
  // Without shifts by other numbers for each, bits are 2^cell as floats converted; 2^31 overflows
  // to just that bit.
  using Words [[gnu::vector_size(16)]] = uint32_t;
  const Words numbers = {0, 1, 2, 3};
  Words columns = x + numbers * columns_per_pair;
  for (uint32_t n = 0; n < pairs; n += 4, columns += 4 * columns_per_pair) {
    constexpr uint32_t kOne = 127 << 23;
    const Words powers = ((columns >> kCellShift) << 23) + kOne;
    const __m128i bits = _mm_cvttps_epi32(reinterpret_cast<__m128>(powers));
    const __m128i is_added = _mm_cmpeq_epi32(
        _mm_and_si128(bits, _mm_loadu_si128(reinterpret_cast<const __m128i*>(of_pairs + n))),
        _mm_setzero_si128());
    is_left_out |= uint64_t{static_cast<uint32_t>(_mm_movemask_ps(_mm_castsi128_ps(is_added))) ^ 15}
                   << n;
  }
#elif defined(SPLINEMAP_NEON)
  using Words [[gnu::vector_size(16)]] = uint32_t;
  const Words numbers = {0, 1, 2, 3};
  Words columns = x + numbers * columns_per_pair;
  for (uint32_t n = 0; n < pairs; n += 4, columns += 4 * columns_per_pair) {
    const Words bits = ((Load<Words>(of_pairs + n) >> (columns >> kCellShift)) & 1) << numbers;
    is_left_out |= uint64_t{vaddvq_u32(reinterpret_cast<uint32x4_t>(bits))} << n;
  }
#else
  for (uint32_t n = 0; n < pairs; ++n, x += columns_per_pair) {
    is_left_out |= uint64_t{of_pairs[n] >> (x >> kCellShift) & 1} << n;
  }
#endif
  return ~is_left_out & kAllPairs >> (64 - pairs);
}

// Masks of eight, by where they are loaded from.
constexpr int32_t kFromEighth[16] = {0, 0, 0, 0, 0, 0, 0, 0, -1, -1, -1, -1, -1, -1, -1, -1};
constexpr int32_t kUpToEighth[16] = {-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0};

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
  const auto columns_per_pair = 2 * static_cast<uint32_t>(line.columns_per_row);
  int64_t column = line.column;
  int32_t row = line.first_row;
  auto left = static_cast<uint32_t>(line.rows);
  while (left > 0) {
    Block* block = plane.At(static_cast<int32_t>(column >> kWidthShift), row >> kBlockShift);
    const uint32_t first_x = static_cast<uint32_t>(column) & (kWidth - 1);
    const uint32_t first_row = static_cast<uint32_t>(row) % kBlockRows;
    const uint32_t most = left < kBlockRows - first_row ? left : kBlockRows - first_row;
    const uint32_t rows = RowsInBlock(first_x, kWidth, most, line.columns_per_row);
    column += int64_t{line.columns_per_row} * rows;
    row += static_cast<int32_t>(rows);
    left -= rows;

    uint64_t pairs = PairsToAdd(block->marks, first_row, (rows + 1) / 2, first_x, columns_per_pair);
    while (pairs != 0) {
      // A run of them, [first, end).
      const auto first = static_cast<uint32_t>(__builtin_ctzll(pairs));
      const uint64_t without = pairs + (uint64_t{1} << first);  // and with one behind them
      const uint32_t end = without == 0 ? 64 : static_cast<uint32_t>(__builtin_ctzll(without));
      pairs &= without;

      const uint32_t run_row = first_row + 2 * first;
      const uint32_t run_x = first_x + first * columns_per_pair;
      uint32_t x = run_x;
      Sum* sums = block->sums + run_row * kStride<Sum>;
      const auto add_pair = [&](Row<Sum> second_mask) {
        const uint32_t phase = (x >> kPhaseShift) & (Table::kPhases - 1);
        const Sum* const pair = row_pairs + phase * (2 * Table::kWidth);
        Sum* const place = sums + (x >> FreeLine::kFractionBits);
        AddTo(Load<Row<Sum>>(pair), place);
        AddTo(Load<Row<Sum>>(pair + Table::kWidth) & second_mask, place + kStride<Sum>);
      };
      for (uint32_t n = first + 1; n < end; ++n) {
        add_pair(~Row<Sum>{});
        sums += 2 * kStride<Sum>;
        x += columns_per_pair;
      }
      // Without a branch, which could not be foretold, for the half of lines that end with a whole
      // pair.
      const uint32_t end_row = first_row + (rows < 2 * end ? rows : 2 * end);
      const auto is_whole = static_cast<Sum>(1 - (end_row - run_row) % 2);
      add_pair(Row<Sum>{} - is_whole);

      const uint32_t groups = GroupsOf(run_row, end_row - 1);
      const uint32_t first_tile = (x < run_x ? x : run_x) >> kTileShift;
      const uint32_t last_tile = ((x < run_x ? run_x : x) + kLastColumn) >> kTileShift;
      static_assert(sizeof block->touched == sizeof(Int32x8));
      const Int32x8 is_touched =
          Load<Int32x8>(kFromEighth + 8 - first_tile) & Load<Int32x8>(kUpToEighth + 7 - last_tile);
      Store(Load<Int32x8>(block->touched) | (is_touched & static_cast<int32_t>(groups)),
            block->touched);
    }
  }
}

template <typename Sum>
void AddLines(const FreeLine* lines, size_t count, const Sum* table, SumPlane<Sum>& plane) {
  for (size_t n = 0; n < count; ++n) AddLine(lines[n], table, plane);
}

// Marks rows of a face, which lie in a block from column `a` to `b` on.
[[gnu::always_inline]] inline void MarkFace(SumBlock<FaceSum>& block, int32_t row, int32_t rows,
                                            int32_t a, int32_t b) {
  const int32_t first = a < b ? a : b;
  const int32_t end = (a < b ? b : a) + FaceLineTable::kWidth;
  const uint32_t groups = GroupsOf(row, row + rows - 1);
  block.touched[0] |= groups;
  block.touched[1] |= end > kSide ? groups : 0;
  const uint32_t cells =
      (2u << ((end - 1) >> SettledCells::kShift)) - (1u << (first >> SettledCells::kShift));
  // They lie in up to three rows of cells.
  static_assert(FaceLine::kMostRows <= 9);
  const int32_t first_row = row >> SettledCells::kShift;
  const int32_t last_row = (row + rows - 1) >> SettledCells::kShift;
  for (const int32_t k : {first_row, (first_row + last_row) / 2, last_row}) {
    block.marks.of_row[k] = static_cast<uint16_t>(block.marks.of_row[k] | cells);
  }
}

template <typename Vector, typename T>
[[gnu::always_inline]] inline Vector SpreadTwo(T a, T b) {
  return Vector{a, a, a, a, b, b, b, b};
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
  const auto first_cell = static_cast<int32_t>(line.column >> FreeLine::kFractionBits);
  const auto fraction =
      static_cast<int32_t>(line.column & ((int64_t{1} << FreeLine::kFractionBits) - 1));
  static_assert(FaceLine::kMostRows <= 8);
  const Int32x8 n = {0, 1, 2, 3, 4, 5, 6, 7};
  const Floats8 n_float = __builtin_convertvector(n, Floats8);
  const Int32x8 column = fraction + n * line.columns_per_row;
  const Int32x8 cells = column >> FreeLine::kFractionBits;
  const Floats8 most_part = face.part + n_float * face.part_per_row;
  const Floats8 part = Lesser(most_part, Floats8{} + 1);
  // Rows beyond the last have no weight.
  constexpr int32_t kNone = 8;
  int32_t cell_of_row[8];
  int32_t phase_of_row[9];
  int32_t weight_of_row[9];
  float share_of_row[9];
  Store(first_cell + skipped + cells, cell_of_row);
  Store((column >> kPhaseShift) & (LineTable::kPhases - 1), phase_of_row);
  const Int32x8 weights =
      face.weight * __builtin_convertvector(part * part * (1 << kPartBits), Int32x8);
  Store(weights & IsLess(n, Int32x8{} + line.rows), weight_of_row);
  Store(face.share + __builtin_convertvector(cells, Floats8) * face.share_per_column +
            n_float * face.share_per_row,
        share_of_row);
  phase_of_row[kNone] = weight_of_row[kNone] = 0;
  share_of_row[kNone] = 0;
  // Two rows at once.
  const Floats8 share_of_columns =
      (static_cast<float>(skipped) + Floats8{0, 1, 2, 3, 0, 1, 2, 3}) * face.share_per_column;
  const auto add_pair = [&](int32_t a, int32_t b, FaceSum* to_a, FaceSum* to_b) {
    const Int32x8 in_whole =
        Joined(Load<Integers4>(rows + phase_of_row[a] * FaceLineTable::kWidth),
               Load<Integers4>(rows + phase_of_row[b] * FaceLineTable::kWidth));
    const Int32x8 weight =
        (in_whole * SpreadTwo<Int32x8>(weight_of_row[a], weight_of_row[b])) >> kPartBits;
    Floats8 share = SpreadTwo<Floats8>(share_of_row[a], share_of_row[b]) + share_of_columns;
    share = Lesser(Greater(share, Floats8{}), Floats8{} + kWhole);
    static_assert(SignedDistance::kWholeShare == 1 << 8);
    const Int32x8 occupied = (weight * __builtin_convertvector(share, Int32x8)) >> 8;
    Int32x8 of_a;
    Int32x8 of_b;
    Interleave(weight, occupied, of_a, of_b);
    AddTo(of_a, to_a);
    AddTo(of_b, to_b);
  };
  const int32_t last = line.rows - 1;
  const int32_t first_row = line.first_row & (kBlockRows - 1);
  if (cell_of_row[0] >> 5 == cell_of_row[last] >> 5 && first_row + last < kBlockRows) {
    SumBlock<FaceSum>& block = *plane.At(cell_of_row[0] >> 5, line.first_row >> kBlockShift);
    FaceSum* sums = block.sums + first_row * kStride<FaceSum>;
    for (int32_t k = 0; k < line.rows; k += 2, sums += 2 * kStride<FaceSum>) {
      add_pair(k, k + 1, sums + (cell_of_row[k] & (kSide - 1)),
               sums + kStride<FaceSum> + (cell_of_row[k + 1] & (kSide - 1)));
    }
    MarkFace(block, first_row, line.rows, cell_of_row[0] & (kSide - 1),
             cell_of_row[last] & (kSide - 1));
    return;
  }
  for (int32_t k = 0; k < line.rows; ++k) {
    const int32_t row = line.first_row + k;
    SumBlock<FaceSum>& block = *plane.At(cell_of_row[k] >> 5, row >> kBlockShift);
    const int32_t place = cell_of_row[k] & (kSide - 1);
    FaceSum* const sums = block.sums + (row & (kBlockRows - 1)) * kStride<FaceSum> + place;
    add_pair(k, kNone, sums, sums);
    MarkFace(block, row & (kBlockRows - 1), 1, place, place);
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

}  // namespace
}  // namespace splinemap::SPLINEMAP_KERNEL
