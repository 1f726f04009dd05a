#include "tests/bench/fleet/map_files.h"

#include <cmath>
#include <functional>
#include <random>

#include "lib/base/status.h"
#include "lib/config/config.h"
#include "splinemap/file.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"

namespace splinemap::bench {

absl::Status WriteMap(const std::string& path, const std::string& robot, int64_t tiles) {
  std::mt19937_64 random(std::hash<std::string>()(robot));
  const MapOptions options = MapOptionsOf({});
  MapWriter map(options);
  const LayerId id{robot, random()};
  Layer& layer = map.AddLayer(id, {1, random()});
  map.SetOwnLayer(id);
  layer.BeginCommit();
  const auto side = static_cast<int64_t>(std::ceil(std::sqrt(static_cast<double>(tiles))));
  for (int64_t n = 0; n < tiles; ++n) {
    const TileKey key{static_cast<int32_t>(n % side - side / 2),
                      static_cast<int32_t>(n / side - side / 2)};
    layer.EditTile(key) = RandomTile(random, options.limits);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(path));
  SPLINEMAP_RETURN_IF_ERROR(file.Save(map.Layers()).status());
  return file.Close();
}

}  // namespace splinemap::bench
