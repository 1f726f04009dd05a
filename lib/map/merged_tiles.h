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
//
// Layers that yield count as one that is not sure: the sum of them is clamped before it is added to
// the others', to 4/5 of the limits. So what robots that are gone have agreed on is overruled by
// one that looks again, after a few scans, whatever their number (tests/bench/layers).
class MergedTiles {
 public:
  // merged[k] = clamp(sum of layers[k] + clamp'(sum of yielding layers[k])), over the layers that
  // `controls` do not leave out, each shifted as they say. What is shifted beyond kMaxKnotIndex is
  // left out. Costs what changed since the last call; all of it where a layer is gone or shifted,
  // lost tiles, or its owner began a new life.
  TileTree Update(const std::vector<LayerSnapshot>& layers, const LayerControls& controls,
                  ControlLimits limits);

 private:
  struct Seen {
    LayerEpoch epoch;
    bool yields;
    KnotShift shift;
    uint64_t line = 0;   // of its tiles
    uint64_t up_to = 0;  // their epoch
  };
  struct Summand {
    const LayerSnapshot* layer;
    bool yields;
    KnotShift shift;
  };
  void MergeTile(TileKey key, const std::vector<Summand>& summands, ControlLimits limits);
  bool GoesOn(const std::vector<Summand>& summands) const;

  std::map<LayerId, Seen> seen_;
  TileTreeEditor merged_;
  std::vector<const Tile*> tiles_;     // of MergeTile()
  std::vector<const Tile*> yielding_;  // the same
};

}  // namespace splinemap
