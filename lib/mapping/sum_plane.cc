#include "lib/mapping/sum_plane.h"

namespace splinemap {

template <typename Sum>
SumBlock<Sum>* SumPlane<Sum>::Add(int32_t column, int32_t row) {
  if (size_ == blocks_.size()) blocks_.push_back(std::make_unique<Block>());
  Block* block = blocks_[size_++].get();
  Block*& bucket = buckets_[HashOf(column, row)];
  block->column = column;
  block->row = row;
  block->next = bucket;
  bucket = block;
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
