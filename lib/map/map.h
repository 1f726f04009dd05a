#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "lib/map/layer.h"
#include "lib/map/layer_control.h"
#include "lib/map/merged_tiles.h"
#include "lib/map/tile.h"
#include "lib/map/tile_tree.h"
#include "lib/spline/surface.h"

namespace splinemap {

// What all layers of a map share. Maps of different options cannot be merged.
struct MapOptions {
  double knot_interval_m = 0.05;
  ControlLimits limits;
  bool operator==(const MapOptions&) const = default;
};

// An immutable view of a map: its layers and their sum. Thread-safe.
struct MapSnapshot {
  MapOptions options;
  std::vector<LayerSnapshot> layers;  // all that are known, those that are not summed, too
  LayerControls controls;
  // The layer that goes on where this map is; none in a map that only collects layers.
  std::optional<LayerId> own_layer;
  // merged[k] = clamp(sum of layers[k]), as `controls` say. Revisions belong to layers; those in
  // here say nothing.
  TileTree merged;

  // Value and gradient of the merged surface at a point of the map frame. Where the coordinates are
  // not finite or beyond kMaxKnotIndex: 0 and not known.
  SurfaceSample Evaluate(double x_m, double y_m) const;

  // The second derivatives of log-odds there, per square metre.
  Eigen::Matrix2d Hessian(double x_m, double y_m) const;

  // The same for many points, faster, most of all where neighbours follow each other or the map is
  // larger than the caches. Requires as many samples as points.
  void EvaluateMany(absl::Span<const Eigen::Vector2d> points_m,
                    absl::Span<SurfaceSample> samples) const;
};

// A set of layers over one knot interval. Thread-compatible; snapshots are for other threads.
class Map {
 public:
  explicit Map(MapOptions options) : options_(options) {}

  const MapOptions& options() const { return options_; }

  // A new layer, empty or going on where `base` ended. It lives as long as the map. Requires that
  // no layer has this id.
  Layer& AddLayer(LayerId id, LayerEpoch epoch);
  Layer& ContinueLayer(const LayerSnapshot& base, LayerEpoch epoch);
  const std::deque<Layer>& layers() const { return layers_; }
  Layer& layer(size_t index) { return layers_[index]; }

  // What snapshots say of them from now on.
  void SetControls(LayerControls controls) { controls_ = std::move(controls); }
  void SetOwnLayer(LayerId id) { own_layer_ = std::move(id); }

  // Costs what changed since the last call.
  std::shared_ptr<const MapSnapshot> Snapshot();

 private:
  MapOptions options_;
  std::deque<Layer> layers_;
  LayerControls controls_;
  std::optional<LayerId> own_layer_;
  MergedTiles merged_;
};

}  // namespace splinemap
