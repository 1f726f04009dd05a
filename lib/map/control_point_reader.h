#pragma once

#include "splinemap/tile_tree.h"

namespace splinemap {

// Reads control points of one tree, neighbours one after the other. The tree outlives it.
class ControlPointReader {
 public:
  explicit ControlPointReader(const TileTree& tiles) : tiles_(tiles) {}

  int At(int32_t i, int32_t j) {
    if (const TileKey key = TileOf(i, j); !is_read_ || key != key_) {
      key_ = key;
      tile_ = FindTile(tiles_, key);
      is_read_ = true;
    }
    return tile_ == nullptr ? 0 : tile_->control_points[IndexInTile(i, j)];
  }

 private:
  const TileTree& tiles_;
  bool is_read_ = false;
  TileKey key_;
  std::shared_ptr<const Tile> tile_;
};

}  // namespace splinemap
