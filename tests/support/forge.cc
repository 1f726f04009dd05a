// forge MAP NAME: saves the layer NAME with the opposite content at the same commits, which no
// owner of a layer can do.
#include <cstdio>
#include <string>

#include "lib/base/status.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

TileTree Negated(const TileTree& tiles) {
  TileTreeEditor negated;
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const auto content = entry.tile->Get();
    Tile& tile = negated.Edit(key, entry.revision).Edit();
    for (int k = 0; k < Tile::kSize; ++k) {
      tile.control_points[k] = static_cast<ControlPoint>(-content->control_points[k]);
    }
  });
  return negated.Freeze();
}

absl::Status Forge(const std::string& path, const std::string& name) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(path));
  LayerSet set = loaded.set;
  for (LayerSnapshot& layer : set.layers) {
    if (layer.id.name == name) layer.tiles = Negated(layer.tiles);
  }
  SPLINEMAP_RETURN_IF_ERROR(file.Save(set).status());
  return file.Close();
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const absl::Status status = splinemap::Forge(argv[1], argv[2]);
  if (!status.ok()) std::fprintf(stderr, "%s\n", splinemap::ErrorText(status).c_str());
  return status.ok() ? 0 : 1;
}
