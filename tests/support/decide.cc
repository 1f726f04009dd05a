// decide MAP NAME [muted] [I J]: saves in the map file that the layer NAME is not summed, or
// shifted by I, J knots; with neither, that it is summed as it is.
// decide MAP NAME negated: saves the layer with the opposite content at the same commits.
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/store/map_file.h"

namespace splinemap {
namespace {

TileTree Negated(const TileTree& tiles) {
  TileTreeEditor negated;
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    Tile& tile = negated.Edit(key, entry.revision);
    for (int k = 0; k < Tile::kSize; ++k) {
      tile.control_points[k] = static_cast<ControlPoint>(-entry.tile->control_points[k]);
    }
  });
  return negated.Freeze();
}

absl::Status Edit(const std::string& path, const std::string& name,
                  const std::vector<std::string>& words) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(path));
  LayerSet set = loaded.set;
  for (LayerSnapshot& layer : set.layers) {
    if (layer.id.name != name) continue;
    if (words == std::vector<std::string>{"negated"}) {
      layer.tiles = Negated(layer.tiles);
      continue;
    }
    LayerSettings setting = set.settings.Next(layer.id, RandomId());
    setting.muted = !words.empty() && words.front() == "muted";
    setting.shift = {};
    if (words.size() == 2) setting.shift = {std::stoi(words[0]), std::stoi(words[1])};
    set.settings.Merge(layer.id, setting);
  }
  SPLINEMAP_RETURN_IF_ERROR(file.Save(set).status());
  return file.Close();
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.size() < 2) return 2;
  const absl::Status status = splinemap::Edit(words[0], words[1], {words.begin() + 2, words.end()});
  if (!status.ok()) std::fprintf(stderr, "%s\n", splinemap::ErrorText(status).c_str());
  return status.ok() ? 0 : 1;
}
