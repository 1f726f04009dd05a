#include "lib/mapping/sum_plane.h"

#include <algorithm>

namespace splinemap {

void SettledCells::Set(const uint64_t (&cells)[kRows]) {
  uint32_t three[kRows + 1];
  for (int row = 0; row < kRows; ++row) {
    three[row] = static_cast<uint32_t>(cells[row] & cells[row] >> 1 & cells[row] >> 2);
  }
  three[kRows] = three[kRows - 1];  // the last row of a block is a pair by itself
  for (int row = 0; row < kRows; ++row) {
    of_pairs[0][2 * row] = of_pairs[0][2 * row + 1] = of_pairs[1][2 * row] = three[row];
    of_pairs[1][2 * row + 1] = three[row] & three[row + 1];
  }
}

template <typename Sum>
SumBlock<Sum>* SumPlane<Sum>::Add(int32_t column, int32_t row) {
  if (size_ == blocks_.size()) blocks_.push_back(std::make_unique<Block>());
  Block* block = blocks_[size_++].get();
  Block*& bucket = buckets_[HashOf(column, row)];
  block->column = column;
  block->row = row;
  block->next = bucket;
  bucket = block;
  if (on_add_) {
    on_add_(*block);
  } else {
    block->marks = {};
  }
  return block;
}

template <typename Sum>
void SumPlane<Sum>::Clear() {
  for (size_t n = 0; n < size_; ++n) {
    buckets_[HashOf(blocks_[n]->column, blocks_[n]->row)] = nullptr;
    for (uint32_t& groups : blocks_[n]->touched) groups = 0;
  }
  size_ = 0;
  constexpr size_t kMaxKept = 1024;  // a scan of 25 m touches some 100
  if (blocks_.size() > kMaxKept) blocks_.resize(kMaxKept);
}

template class SumPlane<int32_t>;
template class SumPlane<uint16_t>;
template class SumPlane<FaceSum>;

}  // namespace splinemap
