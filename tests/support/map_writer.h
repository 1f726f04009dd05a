#pragma once

#include <cstddef>
#include <deque>
#include <memory>
#include <optional>
#include <utility>

#include "lib/map/summed_layers.h"
#include "splinemap/layer.h"
#include "splinemap/layer_set.h"
#include "splinemap/layer_settings.h"
#include "splinemap/map_view.h"

namespace splinemap {

// Layers that a test writes to, of one set of options. Thread-compatible; sets and views are for
// other threads.
class MapWriter {
 public:
  explicit MapWriter(MapOptions options) : options_(options) {}

  const MapOptions& options() const { return options_; }

  // A new layer, empty or going on where `base` ended. It lives as long as this. Requires that no
  // layer has this id.
  Layer& AddLayer(LayerId id, SessionId session) {
    return layers_.emplace_back(std::move(id), session);
  }
  Layer& ContinueLayer(const LayerSnapshot& base, SessionId session) {
    return layers_.emplace_back(base, session);
  }
  const std::deque<Layer>& layers() const { return layers_; }
  Layer& layer(size_t index) { return layers_[index]; }

  // What sets say of them from now on.
  void SetSettings(SettingsTable settings) { settings_ = std::move(settings); }
  void SetOwnLayer(LayerId id) { own_layer_ = std::move(id); }

  // What is stored.
  LayerSet Layers() {
    LayerSet set{.options = options_, .settings = settings_, .own_layer = own_layer_};
    for (Layer& layer : layers_) set.layers.push_back(layer.Snapshot());
    return set;
  }
  // Its sum. Costs what changed since the last call.
  std::shared_ptr<const MapView> View() { return sum_.Update(Layers()); }

 private:
  MapOptions options_;
  std::deque<Layer> layers_;
  SettingsTable settings_;
  std::optional<LayerId> own_layer_;
  SummedLayers sum_;
};

}  // namespace splinemap
