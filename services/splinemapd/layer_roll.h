#pragma once

#include <map>
#include <vector>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/following/map_follower.h"
#include "lib/map/map.h"
#include "lib/map/region.h"
#include "lib/replication/hash_index.h"

namespace splinemap {

// Says of all layers of a map how they are. Costs what changed since the last call.
// Thread-compatible.
class LayerRoll {
 public:
  // The daemon's own layer first, as in `map`; then those without tiles that are removed.
  // `followed` are the others as they were heard.
  std::vector<layer_status_t> Call(const MapSnapshot& map,
                                   const std::vector<FollowedLayer>& followed);

 private:
  struct Tally {
    uint64_t tree_line = 0;
    uint64_t tree_epoch = 0;
    HashIndex hashes;
    TileBox box;
  };
  const Tally& TallyOf(const LayerSnapshot& layer);

  std::map<LayerId, Tally> tallies_;
};

}  // namespace splinemap
