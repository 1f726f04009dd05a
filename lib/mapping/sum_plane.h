#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "splinemap/tile.h"

namespace splinemap {

// What the faces of a scan say of a control point.
struct FaceSum {
  int32_t weight = 0;
  int32_t occupied = 0;  // the part of it that says so
};

// What free lines leave out of a block: cells of 4 x 4 control points, as of TileCells, that are
// settled, and that the scan has no face in.
struct SettledCells {
  static constexpr int kShift = 2;
  static constexpr int kRows = 32;
  // Lines ask for pairs of rows of 8 columns, which lie in up to three cells of a row, or of two.
  // Bit c of of_pairs[is_odd][n]: cells c to c + 2 of the rows 2 n and 2 n + 1, or if they begin
  // with an odd one, of 2 n + 1 and 2 n + 2. Those beyond the last are for kernels that ask for
  // eight at once.
  static constexpr int kPairs = 64;
  uint32_t of_pairs[2][kPairs + 7] = {};

  // Bit c of `cells`: of the cells of a row, whether cell c is left out.
  void Set(const uint64_t (&cells)[kRows]);
};

// The cells that the faces of a scan lie in.
struct FaceCells {
  // Of the faces added to this block, by row of cells; the apron's follow those of the tile.
  uint16_t of_row[SettledCells::kRows] = {};
  TileCells of_tile[4] = {};  // of all, once they are brought together
};

struct NoMarks {};

// How blocks of sums lie in memory: the control points of kAcross x kUp tiles, row-major, and of an
// apron of columns that belong to the block next in x: so a row of 8 sums that begins in a block
// never leaves it. Lines pay for every change from block to block.
template <typename Sum>
struct SumLayout {
  static constexpr int kAcrossBits = 0;
  static constexpr int kApron = 8;
  using Marks = NoMarks;
};
template <>
struct SumLayout<FaceSum> {
  static constexpr int kAcrossBits = 0;
  static constexpr int kApron = 8;
  using Marks = FaceCells;
};
// Sums of 16 bits are small enough for wide blocks, whose rows begin with cache lines.
template <>
struct SumLayout<uint16_t> {
  static constexpr int kAcrossBits = 2;
  static constexpr int kApron = 32;
  using Marks = SettledCells;
};

// Rows are marked as touched in groups, one bit for each.
struct RowGroups {
  static constexpr int kRows = 4;
  static constexpr int kPerTile = Tile::kSide / kRows;
  static constexpr uint32_t kWholeTile = (1u << kPerTile) - 1;
};

// Sums of one scan.
template <typename Sum>
struct alignas(64) SumBlock {
  static constexpr int kAcrossBits = SumLayout<Sum>::kAcrossBits;
  static constexpr int kAcross = 1 << kAcrossBits;
  static constexpr int kUpBits = 2;
  static constexpr int kUp = 1 << kUpBits;
  static_assert(kUp * RowGroups::kPerTile == 32);
  static constexpr int kRows = kUp * Tile::kSide;
  static constexpr int kColumns = kAcross * Tile::kSide;
  static constexpr int kStride = kColumns + SumLayout<Sum>::kApron;

  // The sums of a tile of the block, kStride apart from row to row.
  [[gnu::always_inline]] Sum* TileAt(int across, int up) {
    return sums + up * Tile::kSide * kStride + across * Tile::kSide;
  }

  Sum sums[(kRows + 1) * kStride] = {};  // the last row is always 0
  // By column of tiles, the apron after them: the groups of rows that there may be sums in. As many
  // as kernels take at once.
  uint32_t touched[8] = {};
  static_assert(kAcross < 8);
  typename SumLayout<Sum>::Marks marks;
  int32_t column = 0;  // first tile is (column * kAcross, row * kUp)
  int32_t row = 0;
  SumBlock* next = nullptr;  // with the same hash
};

// The blocks that a scan touches, of sums that are int32_t, uint16_t, which saturate, or FaceSum.
// Keeps its memory from scan to scan, but for what few scans need; blocks out of use are zeros.
// Thread-compatible.
template <typename Sum>
class SumPlane {
 public:
  using Block = SumBlock<Sum>;

  SumPlane() : storage_(size_t{1} << (2 * kHashBits)), buckets_(storage_.data()) {}
  SumPlane(const SumPlane&) = delete;
  SumPlane& operator=(const SumPlane&) = delete;

  // Never null, valid until Clear(). Kernels for one instruction set must not leave copies of it
  // for the rest of the program, and so it is inlined always.
  [[gnu::always_inline]] Block* At(int32_t column, int32_t row) {
    Block* block = Find(column, row);
    return block != nullptr ? block : Add(column, row);
  }
  // Null where there is none.
  [[gnu::always_inline]] Block* Find(int32_t column, int32_t row) const {
    Block* block = buckets_[HashOf(column, row)];
    while (block != nullptr && (block->column != column || block->row != row)) block = block->next;
    return block;
  }

  // Blocks in use, in the order of first use.
  size_t size() const { return size_; }
  Block& block(size_t n) { return *blocks_[n]; }
  const Block& block(size_t n) const { return *blocks_[n]; }

  // Gets each block that is added, to set its marks; null ends that, and they are none.
  void OnAdd(std::function<void(Block& block)> on_add) { on_add_ = std::move(on_add); }

  // Requires that all sums are 0.
  void Clear();

 private:
  // Neighbours never meet in a bucket, and hardly anything else of one scan does.
  static constexpr int kHashBits = 7;
  [[gnu::always_inline]] static size_t HashOf(int32_t column, int32_t row) {
    constexpr uint32_t kMask = (1 << kHashBits) - 1;
    return ((static_cast<uint32_t>(row) & kMask) << kHashBits) |
           (static_cast<uint32_t>(column) & kMask);
  }
  Block* Add(int32_t column, int32_t row);

  std::vector<Block*> storage_;
  Block** buckets_;
  std::vector<std::unique_ptr<Block>> blocks_;  // the first size_ are in use
  size_t size_ = 0;
  std::function<void(Block& block)> on_add_;
};

}  // namespace splinemap
