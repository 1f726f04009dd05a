#pragma once

#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/layers/layer_extent.h"
#include "lib/map/contradictions.h"
#include "lib/replication/hash_tree.h"
#include "lib/replication/map_follower.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// Builds layer_status_t for every layer. Thread-compatible.
class LayerReport {
 public:
  // The daemon's own layer first, as in `set`; then those of which only a removal is left.
  // `followed`: the state of the others. `contradictions`: what is known of them. Costs the layers
  // that changed since the last call.
  std::vector<layer_status_t> Make(const LayerSet& set, const std::vector<FollowedLayer>& followed,
                                   const std::map<LayerId, Contradiction>& contradictions);
  // The same without what is in the layers: settings, sessions, states; num_tiles is 1 where there
  // are some. Costs nothing.
  static std::vector<layer_status_t> Outline(const LayerSet& set,
                                             const std::vector<FollowedLayer>& followed);

 private:
  struct Summary {
    uint64_t lineage = 0;  // of the tiles that are in it
    uint64_t version = 0;
    HashTree hashes;
    LayerExtent extent;
    // Of the extent, at this placement; empty where it is to be made.
    std::optional<std::pair<FixedPose2, std::optional<Region>>> box;
  };
  const std::optional<Region>& BoxOf(Summary& summary, const FixedPose2& placement,
                                     double knot_interval_m);
  Summary& SummaryOf(const LayerSnapshot& layer);

  std::map<LayerId, Summary> summaries_;
};

}  // namespace splinemap
