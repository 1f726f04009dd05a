#include "lib/layers/layer_edits.h"

#include <algorithm>

#include "lib/base/status.h"

namespace splinemap {

absl::StatusOr<LayerSet> WithoutLayers(const LayerSet& set, const std::vector<LayerId>& ids,
                                       uint64_t writer) {
  LayerSet rest{.options = set.options, .settings = set.settings};
  for (const LayerSnapshot& layer : set.layers) {
    if (std::find(ids.begin(), ids.end(), layer.id) == ids.end()) {
      rest.layers.push_back(layer);
      if (set.own_layer == layer.id) rest.own_layer = layer.id;
      continue;
    }
    const LayerSettings removal = rest.settings.Removal(layer.id, layer.session, writer);
    if (!removal.IsValid() || !rest.settings.Merge(layer.id, removal)) {
      return FailedPrecondition("no further layer can be removed: its settings have no room");
    }
  }
  return rest;
}

}  // namespace splinemap
