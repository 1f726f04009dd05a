#pragma once

// Lines, faces and samples added to sums. A part of scan_kernel_impl.h.

#include "lib/mapping/kernel_lanes.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

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

}  // namespace
}  // namespace splinemap::SPLINEMAP_KERNEL
