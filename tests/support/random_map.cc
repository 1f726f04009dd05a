#include "tests/support/random_map.h"

namespace splinemap {

Tile RandomTile(std::mt19937_64& random, ControlLimits limits) {
  std::uniform_int_distribution<int> value(limits.min, limits.max);
  std::uniform_int_distribution<int> step(-300, 300);
  std::bernoulli_distribution touched(0.6);
  Tile tile;
  int32_t walk = value(random);
  for (ControlPoint& c : tile.control_points) {
    walk += step(random);
    if (touched(random)) c = ClampTouched(walk, limits);
  }
  tile.control_points[0] = 1;
  return tile;
}

TileKey RandomKey(std::mt19937_64& random, int extent) {
  std::uniform_int_distribution<int32_t> coordinate(-extent, extent);
  const int32_t tx = coordinate(random);
  return {tx, coordinate(random)};
}

}  // namespace splinemap
