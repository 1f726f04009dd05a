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

PosedScan RandomScan(std::mt19937_64& random, double half_width_m) {
  std::uniform_real_distribution<double> place(-half_width_m, half_width_m);
  std::uniform_real_distribution<double> uniform(0, 1);
  PosedScan scan;
  scan.utime = Utime(static_cast<int64_t>(random() % (int64_t{1} << 50)));
  const double x = place(random);
  scan.world_T_robot = FixedPose2::Nearest({{x, place(random)}, 6 * uniform(random)});
  const bool is_moving = uniform(random) < 0.2;
  const double range_m = 0.5 + 2 * uniform(random);
  for (int k = 0; k < 24; ++k) {
    Beam beam;
    beam.reading = static_cast<uint16_t>(k);
    beam.bearing_rad = static_cast<float>(0.1 * k);
    beam.range_m = static_cast<float>(range_m + 0.3 * uniform(random));
    beam.hit = uniform(random) < 0.9;
    scan.beams.push_back(beam);
    if (is_moving || k == 0) {
      scan.robot_T_sensor.push_back(FixedPose2::Nearest({{0.1, 0.002 * k}, 0.001 * k}));
    }
  }
  return scan;
}

TileKey RandomKey(std::mt19937_64& random, int extent) {
  std::uniform_int_distribution<int32_t> coordinate(-extent, extent);
  const int32_t tx = coordinate(random);
  return {tx, coordinate(random)};
}

}  // namespace splinemap
