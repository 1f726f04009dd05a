#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>

#include "absl/types/span.h"
#include "splinemap/layer_set.h"
#include "splinemap/surface.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The sum of the layers of a map: the surface that queries are about. Made by SummedLayers, never
// stored, never replicated. Immutable, thread-safe.
struct MapView {
  MapOptions options;
  uint64_t revision = 0;  // commits to all layers
  // tiles[k] = clamp(sum of layers[k]), as the settings say. Their revisions mean nothing.
  TileTree tiles;

  // Value and gradient of the surface at a point of the map frame. Where the coordinates are not
  // finite or beyond kMaxKnotIndex: 0 and not known.
  SurfaceSample Evaluate(double x_m, double y_m) const;

  // The second derivatives of log-odds there, per square metre.
  Eigen::Matrix2d Hessian(double x_m, double y_m) const;

  // The same for many points, faster, most of all where neighbours follow each other or the map is
  // larger than the caches. Requires as many samples as points.
  void EvaluateMany(absl::Span<const Eigen::Vector2d> points_m,
                    absl::Span<SurfaceSample> samples) const;
};

// The surface at points that follow each other closely, one by one, as along a path: keeps the
// tiles of the last. Gives what MapView::Evaluate() gives. Thread-compatible.
class PathReader {
 public:
  explicit PathReader(std::shared_ptr<const MapView> map);

  SurfaceSample Evaluate(double x_m, double y_m);

 private:
  struct Place {
    TileKey key;
    std::shared_ptr<const Tile> tile;
  };
  const Tile& TileAt(TileKey key);

  std::shared_ptr<const MapView> map_;
  std::array<Place, 4>
      places_;  // by whether coordinates of the key are odd: of any square of tiles
};

// The sum of a set that does not change. Costs the whole map.
std::shared_ptr<const MapView> ViewOf(const LayerSet& set);

}  // namespace splinemap
