#pragma once

// Lines, faces and samples added to sums. A part of scan_kernel_impl.h.

#include <type_traits>

#include "lib/mapping/kernel_lanes.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

// So many of `rows`, from column x of a block on, lie in pairs that begin in it.
[[gnu::always_inline]] inline int32_t RowsInBlock(uint32_t x, int64_t width, int32_t rows,
                                                  int32_t columns_per_row) {
  const int64_t last = x + int64_t{columns_per_row} * ((rows - 1) & ~1);
  if (last >= 0 && last < width) return rows;
  const auto way = static_cast<uint32_t>(columns_per_row > 0 ? width - 1 - x : x);
  const auto per_row =
      static_cast<uint32_t>(columns_per_row > 0 ? columns_per_row : -columns_per_row);
  return static_cast<int32_t>(way / per_row + 2) & ~1;
}

// What is left out of a block of free lines.
class LeftOut {
 public:
  // Of up to eight rows, whose pairs begin within `way`, a fixed-point number of columns up to 6.
  LeftOut(const SettledCells& settled, uint32_t way)
      : runs_(settled.runs[(way + kSpareColumns) >> kCellShift]) {}
  // From a row on, where the leftmost pair begins in column x.
  [[gnu::always_inline]] bool Has(int32_t row, uint32_t x) const {
    return (runs_[row >> SettledCells::kShift] >> (x >> kCellShift) & 1) != 0;
  }

 private:
  static constexpr int kCellShift = FreeLine::kFractionBits + SettledCells::kShift;
  // They begin anywhere in a cell, and have eight columns: one less than three cells.
  static constexpr uint32_t kSpareColumns = 3u << FreeLine::kFractionBits;
  static_assert(((6u << FreeLine::kFractionBits) + kSpareColumns) >> kCellShift <
                SettledCells::kRuns);

  const uint64_t* runs_;
};
// Nothing is, of other lines.
class NothingLeftOut {
 public:
  NothingLeftOut(const NoMarks&, uint32_t) {}
  [[gnu::always_inline]] bool Has(int32_t, uint32_t) const { return false; }
};

// The part of a line that lies in a block.
struct LinePart {
  uint32_t x;  // column in the block of the first row that is left
  int32_t row;
  int32_t rows;
};

template <typename Sum>
void AddLine(const FreeLine& line, const Sum* table, SumPlane<Sum>& plane) {
  using Table = FreeLineTable<Sum>;
  using Block = SumBlock<Sum>;
  using Left = std::conditional_t<sizeof(Sum) == sizeof(uint16_t), LeftOut, NothingLeftOut>;
  constexpr int32_t kRowsAtOnce = 8;
  constexpr int kTileShift = FreeLine::kFractionBits + 5;
  constexpr int kWidthShift = kTileShift + Block::kAcrossBits;
  constexpr uint32_t kWidth = uint32_t{1} << kWidthShift;
  constexpr int kPhaseShift = FreeLine::kFractionBits - Table::kPhaseBits;
  constexpr uint32_t kLastColumn = (Table::kWidth - 1) << FreeLine::kFractionBits;
  const Sum* const row_pairs = table + ptrdiff_t{line.slope} * Table::kSumsPerSlope;
  const auto columns_per_row = static_cast<uint32_t>(line.columns_per_row);
  const uint32_t columns_per_pair = 2 * columns_per_row;
  const bool is_leftwards = line.columns_per_row < 0;
  int64_t column = line.column;
  int32_t row = line.first_row;
  int32_t left = line.rows;
  while (left > 0) {
    Block* block = plane.At(static_cast<int32_t>(column >> kWidthShift), row >> kBlockShift);
    LinePart part{static_cast<uint32_t>(column) & (kWidth - 1), row & (kBlockRows - 1), 0};
    const int32_t most = left < kBlockRows - part.row ? left : kBlockRows - part.row;
    part.rows = RowsInBlock(part.x, kWidth, most, line.columns_per_row);
    const Left left_out(block->marks, is_leftwards ? -3 * columns_per_pair : 3 * columns_per_pair);
    column += int64_t{line.columns_per_row} * part.rows;
    row += part.rows;
    left -= part.rows;

    const auto is_left_out = [&](int32_t after, int32_t rows) {
      const uint32_t x = part.x + static_cast<uint32_t>(after) * columns_per_row;
      const uint32_t way = static_cast<uint32_t>((rows - 1) / 2) * columns_per_pair;
      return left_out.Has(part.row + after, is_leftwards ? x + way : x);
    };
    const auto add = [&](int32_t rows) {
      uint32_t x = part.x;
      Sum* sums = block->sums + part.row * kStride<Sum>;
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
      const auto is_whole = static_cast<Sum>(1 - rows % 2);
      add_pair(Row<Sum>{} - is_whole);

      const uint32_t groups = GroupsOf(part.row, part.row + rows - 1);
      const auto first = static_cast<int32_t>((x < part.x ? x : part.x) >> kTileShift);
      const auto last =
          static_cast<int32_t>(((x < part.x ? part.x : x) + kLastColumn) >> kTileShift);
      const Int32x8 tile = {0, 1, 2, 3, 4, 5, 6, 7};
      static_assert(sizeof block->touched == sizeof tile);
      Store(Load<Int32x8>(block->touched) |
                ((tile >= first) & (tile <= last) & static_cast<int32_t>(groups)),
            block->touched);
    };
    const auto advance = [&](int32_t rows) {
      part.x += static_cast<uint32_t>(rows) * columns_per_row;
      part.row += rows;
      part.rows -= rows;
    };
    while (part.rows > 0) {
      while (part.rows >= kRowsAtOnce && is_left_out(0, kRowsAtOnce)) advance(kRowsAtOnce);
      if (part.rows < kRowsAtOnce) {
        if (part.rows > 0 && !is_left_out(0, part.rows)) add(part.rows);
        break;
      }
      int32_t rows = kRowsAtOnce;
      while (part.rows - rows >= kRowsAtOnce && !is_left_out(rows, kRowsAtOnce)) {
        rows += kRowsAtOnce;
      }
      const int32_t rest = part.rows - rows;
      if (rest > 0 && rest < kRowsAtOnce && !is_left_out(rows, rest)) rows += rest;
      add(rows);
      advance(rows);
    }
  }
}

template <typename Sum>
void AddLines(const FreeLine* lines, size_t count, const Sum* table, SumPlane<Sum>& plane) {
  for (size_t n = 0; n < count; ++n) {
    // What the next line needs of the table, which is larger than the fastest cache.
    const FreeLine& next = lines[n + 1 < count ? n + 1 : n];
    const Sum* const row_pairs = table + ptrdiff_t{next.slope} * FreeLineTable<Sum>::kSumsPerSlope;
    constexpr int kSumsPerCacheLine = 64 / sizeof(Sum);
    for (int k = 0; k < FreeLineTable<Sum>::kSumsPerSlope; k += kSumsPerCacheLine) {
      __builtin_prefetch(row_pairs + k);
    }
    AddLine(lines[n], table, plane);
  }
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
  for (int32_t k = row >> SettledCells::kShift; k <= (row + rows - 1) >> SettledCells::kShift;
       ++k) {
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
  const Floats8 part = most_part < 1 ? most_part : Floats8{} + 1;
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
  Store(n < line.rows ? weights : Int32x8{}, weight_of_row);
  Store(face.share + __builtin_convertvector(cells, Floats8) * face.share_per_column +
            n_float * face.share_per_row,
        share_of_row);
  phase_of_row[kNone] = weight_of_row[kNone] = 0;
  share_of_row[kNone] = 0;
  // Two rows at once.
  const Floats8 share_of_columns =
      (static_cast<float>(skipped) + Floats8{0, 1, 2, 3, 0, 1, 2, 3}) * face.share_per_column;
  const auto add_pair = [&](int32_t a, int32_t b, FaceSum* to_a, FaceSum* to_b) {
    const auto in_whole = __builtin_shufflevector(
        Load<Integers4>(rows + phase_of_row[a] * FaceLineTable::kWidth),
        Load<Integers4>(rows + phase_of_row[b] * FaceLineTable::kWidth), 0, 1, 2, 3, 4, 5, 6, 7);
    const Int32x8 weight =
        (in_whole * SpreadTwo<Int32x8>(weight_of_row[a], weight_of_row[b])) >> kPartBits;
    Floats8 share = SpreadTwo<Floats8>(share_of_row[a], share_of_row[b]) + share_of_columns;
    share = share < 0 ? Floats8{} : share;
    share = share > kWhole ? Floats8{} + kWhole : share;
    static_assert(SignedDistance::kWholeShare == 1 << 8);
    const Int32x8 occupied = (weight * __builtin_convertvector(share, Int32x8)) >> 8;
    AddTo(__builtin_shufflevector(weight, occupied, 0, 8, 1, 9, 2, 10, 3, 11), to_a);
    AddTo(__builtin_shufflevector(weight, occupied, 4, 12, 5, 13, 6, 14, 7, 15), to_b);
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
