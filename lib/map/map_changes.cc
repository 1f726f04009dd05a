#include "lib/map/map_changes.h"

#include <algorithm>

namespace splinemap {
namespace {

bool IsGoneOn(const LayerSnapshot& before, const LayerSnapshot& after) {
  return before.id == after.id && before.epoch == after.epoch &&
         before.tiles.size() <= after.tiles.size();  // within an epoch tiles do not vanish
}

}  // namespace

TileBox ChangedTiles(const MapSnapshot& before, const MapSnapshot& after) {
  TileBox box;
  const auto add = [&](TileKey key, const TileTree::Entry&) { box.Add(key); };
  const bool same_layers = std::equal(before.layers.begin(), before.layers.end(),
                                      after.layers.begin(), after.layers.end(), IsGoneOn);
  if (!same_layers) {
    before.merged.ForEach(add);
    after.merged.ForEach(add);
    return box;
  }
  for (size_t k = 0; k < after.layers.size(); ++k) {
    after.layers[k].tiles.ForEachChanged(before.layers[k].tiles.epoch(), add);
  }
  return box;
}

}  // namespace splinemap
