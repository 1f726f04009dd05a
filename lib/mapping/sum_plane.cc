#include "lib/mapping/sum_plane.h"

namespace splinemap {

SumBlock* SumPlane::Add(int32_t tx, int32_t ty) {
  if (size_ == blocks_.size()) blocks_.push_back(std::make_unique<SumBlock>());
  SumBlock* block = blocks_[size_++].get();
  SumBlock*& bucket = buckets_[HashOf(tx, ty)];
  block->key = {tx, ty};
  block->next = bucket;
  bucket = block;
  return block;
}

void SumPlane::Clear() {
  for (size_t n = 0; n < size_; ++n) {
    buckets_[HashOf(blocks_[n]->key.tx, blocks_[n]->key.ty)] = nullptr;
  }
  size_ = 0;
}

}  // namespace splinemap
