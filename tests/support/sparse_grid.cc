#include "tests/support/sparse_grid.h"

namespace splinemap {

double& SparseGrid::At(int32_t i, int32_t j) {
  const TileKey key = TileOf(i, j);
  if (last_ == nullptr || key != last_key_) {
    std::unique_ptr<Square>& square = squares_[key];
    if (square == nullptr) square = std::make_unique<Square>();
    last_key_ = key;
    last_ = square.get();
  }
  return (*last_)[IndexInTile(i, j)];
}

double SparseGrid::Get(int32_t i, int32_t j) const {
  const auto found = squares_.find(TileOf(i, j));
  return found == squares_.end() ? 0 : (*found->second)[IndexInTile(i, j)];
}

}  // namespace splinemap
