#pragma once

#include <cstdint>
#include <vector>

#include "lib/map/layer.h"
#include "lib/map/tile.h"
#include "lib/map/tile_tree.h"

namespace splinemap {

// The sum of layers, kept up to date. Thread-compatible.
class MergedTiles {
 public:
  // merged[k] = clamp(sum of layers[k]). Costs what changed since the last call; all of it where a
  // layer is gone or its owner began a new life.
  TileTree Update(const std::vector<LayerSnapshot>& layers, ControlLimits limits);

 private:
  struct Seen {
    LayerId id;
    LayerEpoch epoch;
    uint64_t up_to = 0;  // epoch of its tiles
  };
  bool GoesOn(const std::vector<LayerSnapshot>& layers) const;

  std::vector<Seen> seen_;  // the first of the layers, in their order
  TileTreeEditor merged_;
};

}  // namespace splinemap
