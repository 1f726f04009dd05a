#include "lib/map/flattened.h"

#include <algorithm>
#include <utility>

#include "lib/map/summed_layers.h"

namespace splinemap {

LayerSet Flattened(const LayerSet& set, LayerId id, SessionId session) {
  uint64_t revision = 0;
  for (const LayerSnapshot& layer : set.layers) {
    if (!set.settings.Of(layer.id).IsSummed()) continue;
    // Files may claim nearly endless numbers of commits.
    revision = std::min(revision + layer.revision, kMaxRevision);
  }
  Layer layer(std::move(id), session);
  layer.RestoreRevision(std::max<uint64_t>(revision, 1));
  ViewOf(set)->tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    layer.RestoreTile(key, entry.tile, layer.revision());
  });
  return {.options = set.options, .layers = {layer.Snapshot()}};
}

}  // namespace splinemap
