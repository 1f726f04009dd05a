#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "splinemap/tile.h"

namespace splinemap {

// Sums of one scan over the control points of 4 tiles, one above the other, row-major, and of an
// apron of 8 columns that belong to the block next in x: so a row of 8 sums that begins in a block
// never leaves it. Higher than wide since the beams of a plane are steep, and pay for every change
// from block to block.
struct alignas(64) SumBlock {
  static constexpr int kTiles = 4;
  static constexpr int kRows = kTiles * Tile::kSide;
  static constexpr int kApron = 8;
  static constexpr int kStride = Tile::kSide + kApron;

  int32_t sums[kRows * kStride] = {};
  uint32_t touched = 0;      // bit k: there may be sums in tile k, counted upwards, or its apron
  int32_t tx = 0;            // of the tiles
  int32_t row = 0;           // first tile is (tx, row * kTiles)
  SumBlock* next = nullptr;  // with the same hash
};

// The blocks that a scan touches. Keeps its memory from scan to scan; blocks out of use are zeros.
// Thread-compatible.
class SumPlane {
 public:
  SumPlane() : storage_(size_t{1} << (2 * kHashBits)), buckets_(storage_.data()) {}
  SumPlane(const SumPlane&) = delete;
  SumPlane& operator=(const SumPlane&) = delete;

  // Never null, valid until Clear(). Kernels for one instruction set must not leave copies of it
  // for the rest of the program, and so it is inlined always.
  [[gnu::always_inline]] SumBlock* At(int32_t tx, int32_t row) {
    SumBlock* block = Find(tx, row);
    return block != nullptr ? block : Add(tx, row);
  }
  // Null where there is none.
  [[gnu::always_inline]] SumBlock* Find(int32_t tx, int32_t row) const {
    SumBlock* block = buckets_[HashOf(tx, row)];
    while (block != nullptr && (block->tx != tx || block->row != row)) block = block->next;
    return block;
  }

  // Blocks in use, in the order of first use.
  size_t size() const { return size_; }
  SumBlock& block(size_t n) { return *blocks_[n]; }

  // Requires that all sums are 0.
  void Clear();

 private:
  // Neighbours never meet in a bucket, and hardly anything else of one scan does.
  static constexpr int kHashBits = 7;
  [[gnu::always_inline]] static size_t HashOf(int32_t tx, int32_t row) {
    constexpr uint32_t kMask = (1 << kHashBits) - 1;
    return ((static_cast<uint32_t>(row) & kMask) << kHashBits) |
           (static_cast<uint32_t>(tx) & kMask);
  }
  SumBlock* Add(int32_t tx, int32_t row);

  std::vector<SumBlock*> storage_;
  SumBlock** buckets_;
  std::vector<std::unique_ptr<SumBlock>> blocks_;  // the first size_ are in use
  size_t size_ = 0;
};

}  // namespace splinemap
