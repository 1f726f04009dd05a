#include "lib/mapping/sum_plane.h"

namespace splinemap {

SumBlock* SumPlane::Add(int32_t tx, int32_t row) {
  if (size_ == blocks_.size()) blocks_.push_back(std::make_unique<SumBlock>());
  SumBlock* block = blocks_[size_++].get();
  SumBlock*& bucket = buckets_[HashOf(tx, row)];
  block->tx = tx;
  block->row = row;
  block->next = bucket;
  bucket = block;
  return block;
}

void SumPlane::Clear() {
  for (size_t n = 0; n < size_; ++n) {
    buckets_[HashOf(blocks_[n]->tx, blocks_[n]->row)] = nullptr;
    blocks_[n]->touched = 0;
  }
  size_ = 0;
}

}  // namespace splinemap
