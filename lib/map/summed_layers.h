#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "lib/map/placed_tile.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/layer_set.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/map_view.h"
#include "splinemap/tile.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The sum of layers, kept up to date. Thread-compatible.
//
// Layers of low weight count as one that is not sure: their sum is clamped to 4/5 of the limits
// before it is added to the others. So one robot that looks again overrules any number of robots
// that left, after a few scans (tests/bench/layers).
class SummedLayers {
 public:
  // Of layers at that level of detail. `memory` bounds how many sums are in memory; null: nothing
  // does.
  explicit SummedLayers(LevelOfDetail level_of_detail = {},
                        std::shared_ptr<TileMemory> memory = nullptr)
      : level_of_detail_(level_of_detail), memory_(std::move(memory)) {}

  // tiles[k] = clamp(sum of layers[k] + clamp'(sum of layers of low weight[k])), over the layers
  // that the settings do not leave out, each placed as they say. Requires layers whose control
  // points are within the limits of the set. What is placed beyond
  // kMaxKnotIndex is left out. Tiles are summed when somebody asks for them. Costs what changed
  // since the last call; the keys of the whole map where a layer is gone or placed anew, lost
  // tiles, or its owner started a new session.
  std::shared_ptr<const MapView> Update(const LayerSet& set);

 private:
  struct Seen {
    SessionId session;
    bool low_weight;
    KnotPlacement placement;
    uint64_t lineage = 0;  // of its tiles
    uint64_t up_to = 0;    // their version
  };
  struct Summand {
    const LayerSnapshot* layer;
    bool low_weight;
    KnotPlacement placement;
  };
  TileTree Sum(const LayerSet& set);
  void SumTile(TileKey key, const std::vector<Summand>& summands, ControlLimits limits);
  bool Continues(const std::vector<Summand>& summands) const;

  LevelOfDetail level_of_detail_;
  std::shared_ptr<TileMemory> memory_;
  std::map<LayerId, Seen> seen_;
  TileTreeEditor sum_;
};

}  // namespace splinemap
