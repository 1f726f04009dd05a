#pragma once

#include <map>
#include <vector>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/layers/layer_extent.h"
#include "lib/map/contradictions.h"
#include "lib/replication/hash_tree.h"
#include "lib/replication/map_follower.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// Builds layer_status_t for every layer. Costs what changed since the last call. Thread-compatible.
class LayerReport {
 public:
  // The daemon's own layer first, as in `set`; then those of which only a removal is left.
  // `followed`: the state of the others. `contradictions`: what is known of them.
  std::vector<layer_status_t> Make(const LayerSet& set, const std::vector<FollowedLayer>& followed,
                                   const std::map<LayerId, Contradiction>& contradictions);

 private:
  struct Summary {
    uint64_t lineage = 0;  // of the tiles that are in it
    uint64_t version = 0;
    HashTree hashes;
    LayerExtent extent;
  };
  const Summary& SummaryOf(const LayerSnapshot& layer);

  std::map<LayerId, Summary> summaries_;
};

}  // namespace splinemap
