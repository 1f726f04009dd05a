#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "splinemap/map_view.h"
#include "splinemap/tile.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

inline constexpr double kKnotInterval_m = 0.05;

// Layers of several robots, as one of them reads them.
struct LayersOfRobots {
  std::vector<TileTree> tiles;
  // Layers from here on are the reader's, and of robots that see the same; earlier ones are
  // others'.
  size_t first_own = 0;
};

// A way to read one map from layers. It looks at their control points alone, in any order, so that
// it is exact on every replica, and a layer can be taken back.
struct Scheme {
  std::string name;
  double layer_clamp = 10;   // log-odds that layers are clamped to when they are written
  double merged_clamp = 10;  // and the merged map, once, at the end
  // Log-odds of one control point, in units of it, of the layers that touched it; not empty.
  using Read = std::function<double(absl::Span<const ControlPoint> others,
                                    absl::Span<const ControlPoint> own)>;
  Read read;
};

// All that are compared, in groups of one layer_clamp, which can read the same layers. The first of
// the first group is the sum with the defaults.
std::vector<std::vector<Scheme>> SchemesByClamp();

// The merged map; of `keys` alone where there are any.
MapView Merge(const LayersOfRobots& layers, const Scheme& scheme,
              const std::vector<TileKey>& keys = {});

}  // namespace splinemap
