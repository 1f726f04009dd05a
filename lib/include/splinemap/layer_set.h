#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "splinemap/layer.h"
#include "splinemap/layer_settings.h"
#include "splinemap/tile.h"

namespace splinemap {

// What all layers of a map share. Maps of different options cannot be merged.
struct MapOptions {
  double knot_interval_m = 0.05;
  ControlLimits limits;
  bool operator==(const MapOptions&) const = default;
};

// The layers of a map and the settings of people about them: what is stored, replicated and
// reported. Its sum is a MapView. Cheap to copy; thread-safe where it does not change.
struct LayerSet {
  MapOptions options;
  std::vector<LayerSnapshot> layers{};  // all that are known, those that are not summed, too
  SettingsTable settings{};
  // The layer that the owner of the map continues; none in a map that only collects layers.
  std::optional<LayerId> own_layer{};

  // Null where there is none.
  const LayerSnapshot* Find(const LayerId& id) const {
    const auto layer = std::find_if(layers.begin(), layers.end(),
                                    [&](const LayerSnapshot& other) { return other.id == id; });
    return layer == layers.end() ? nullptr : &*layer;
  }
};

}  // namespace splinemap
