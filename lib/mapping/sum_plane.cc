#include "lib/mapping/sum_plane.h"

#include <algorithm>

namespace splinemap {

void SettledCells::Set(const uint64_t (&cells)[kRows]) {
  uint64_t rows[kRows + 2];
  std::copy_n(cells, kRows, rows);
  rows[kRows] = rows[kRows + 1] = ~uint64_t{0};  // no line goes on there
  for (int row = 0; row < kRows; ++row) {
    const uint64_t one = rows[row] & rows[row + 1] & rows[row + 2];
    const uint64_t two = one & one >> 1;
    runs[0][row] = two & one >> 2;
    runs[1][row] = two & two >> 2;
    runs[2][row] = two & two >> 2 & one >> 4;
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
  block->marks = {};
  if (on_add_) on_add_(*block);
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
