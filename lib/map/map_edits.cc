#include "lib/map/map_edits.h"

#include <algorithm>
#include <utility>

#include "lib/base/status.h"

namespace splinemap {

absl::StatusOr<std::shared_ptr<const MapSnapshot>> WithoutLayers(const MapSnapshot& map,
                                                                 const std::vector<LayerId>& ids,
                                                                 uint64_t writer) {
  LayerControls controls = map.controls;
  Map rest(map.options);
  for (const LayerSnapshot& layer : map.layers) {
    if (std::find(ids.begin(), ids.end(), layer.id) == ids.end()) {
      rest.ContinueLayer(layer, layer.epoch);
      if (map.own_layer == layer.id) rest.SetOwnLayer(layer.id);
      continue;
    }
    const LayerControl removal = controls.Removal(layer.id, layer.epoch.incarnation, writer);
    if (!removal.IsValid() || !controls.Take(layer.id, removal)) {
      return FailedPrecondition("no further layer can be removed: its record has no room");
    }
  }
  rest.SetControls(std::move(controls));
  return rest.Snapshot();
}

std::shared_ptr<const MapSnapshot> Flattened(const MapSnapshot& map, LayerId id, LayerEpoch epoch) {
  uint64_t revision = 0;
  for (const LayerSnapshot& layer : map.layers) {
    if (!map.controls.Of(layer.id).IsSummed()) continue;
    // Files may claim nearly endless numbers of commits.
    revision = std::min(revision + layer.revision, kMaxRevision);
  }
  Map flat(map.options);
  Layer& layer = flat.AddLayer(std::move(id), epoch);
  layer.RestoreRevision(std::max<uint64_t>(revision, 1));
  map.merged.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    layer.RestoreTile(key, entry.tile, layer.revision());
  });
  return flat.Snapshot();
}

}  // namespace splinemap
