#pragma once

#include "splinemap/layer.h"

namespace splinemap::bench {

// Tiles with random content in a square around the origin, as many as one that wide holds.
class TileSquare {
 public:
  explicit TileSquare(size_t num_tiles);

  // Half the width, in tiles: keys run over [-half, half).
  int32_t half() const { return half_; }
  size_t num_tiles() const { return 4 * static_cast<size_t>(half_) * half_; }

  // One commit with all of the tiles.
  void CommitTo(Layer& layer) const;

 private:
  int32_t half_;
};

}  // namespace splinemap::bench
