#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "lib/map/layer.h"
#include "lib/map/layer_control.h"
#include "lib/map/tile.h"
#include "lib/map/tile_tree.h"

namespace splinemap {

// The sum of layers, kept up to date. Thread-compatible.
class MergedTiles {
 public:
  // merged[k] = clamp(sum of layers[k]), over the layers that `controls` do not leave out, each
  // shifted as they say; what is shifted beyond kMaxKnotIndex is left out. Costs what changed since
  // the last call; all of it where a layer is gone or shifted, or its owner began a new life.
  TileTree Update(const std::vector<LayerSnapshot>& layers, const LayerControls& controls,
                  ControlLimits limits);

 private:
  struct Seen {
    LayerEpoch epoch;
    KnotShift shift;
    uint64_t up_to = 0;  // epoch of its tiles
  };
  struct Summand {
    const LayerSnapshot* layer;
    KnotShift shift;
  };
  bool GoesOn(const std::vector<Summand>& summands) const;

  std::map<LayerId, Seen> seen_;
  TileTreeEditor merged_;
};

}  // namespace splinemap
