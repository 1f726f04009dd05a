#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// The state of a layer that results from two of one LayerId: the greater session as a whole; of one
// session, each tile at its greatest revision. Copies of one layer have one content at a revision;
// of two, the one greater in order of its control points counts, and `conflicting_tiles` grows by
// one. Commutative, associative, idempotent.
LayerSnapshot Merge(const LayerSnapshot& a, const LayerSnapshot& b, int64_t& conflicting_tiles);

// The union of maps: every layer of them in the newest state that one has, the layers apart. What
// counts is which maps it took, not in what order, in what groups or how often. Thread-compatible.
class LayerUnion {
 public:
  explicit LayerUnion(MapOptions options) : options_(options) {}

  // A layer of which the union and a map that it took had other than older and newer copies.
  struct Conflict {
    LayerId id;
    SessionId kept;
    SessionId dropped;              // equal to `kept` where tiles contradict each other
    bool is_map_newer = false;      // the map's copy was kept, the union's dropped
    int64_t conflicting_tiles = 0;  // tiles of one revision and different content
  };

  // Requires equal options. FailedPrecondition where people have decided about more layers than
  // SettingsTable::kMax; the union is unchanged then.
  absl::StatusOr<std::vector<Conflict>> Add(const LayerSet& map);

  // Layers that are left out: they were taken, and so were records that remove them.
  std::vector<LayerId> Removed() const;

  // Layers in order of their ids; nobody owns one of them here.
  LayerSet Layers() const;

 private:
  MapOptions options_;
  std::map<LayerId, LayerSnapshot> layers_;  // the removed, too
  SettingsTable settings_;
};

}  // namespace splinemap
