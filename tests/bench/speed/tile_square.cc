#include "tests/bench/speed/tile_square.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "tests/support/random_map.h"

namespace splinemap::bench {

TileSquare::TileSquare(size_t num_tiles)
    : half_(std::max(
          1, static_cast<int32_t>(std::lround(std::sqrt(static_cast<double>(num_tiles)) / 2)))) {}

void TileSquare::CommitTo(Layer& layer) const {
  std::mt19937_64 random(1);
  std::vector<Tile> contents;  // a few, since making them takes long
  for (int n = 0; n < 61; ++n) contents.push_back(RandomTile(random));
  layer.BeginCommit();
  size_t n = 0;
  for (int32_t ty = -half_; ty < half_; ++ty) {
    for (int32_t tx = -half_; tx < half_; ++tx) {
      layer.EditTile({tx, ty}) = contents[n++ % contents.size()];
    }
  }
}

}  // namespace splinemap::bench
