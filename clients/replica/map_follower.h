#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lib/map/detail.h"
#include "lib/map/map.h"
#include "lib/map/region.h"
#include "lib/replication/layer_follower.h"

namespace splinemap {

// Which layers to follow, and what of them.
struct FollowOptions {
  std::string channel_prefix = "SPLINEMAP";
  std::vector<std::string> names;  // of robots; empty: all
  std::optional<Region> region;    // in the map frame; none: all of the map
  // Coarser levels are made by the daemons while somebody follows them: smoothed values, or the
  // least or greatest log-odds of the squares of 2^level x 2^level control points, so that
  // obstacles stay. The knot interval of the copy is 2^level times the map's. Control point (i, j)
  // stands for finer ones from (i, j) 2^level on.
  Detail detail;
  // Of one layer; what is beyond is left out, and the layer never in sync.
  size_t max_tiles_per_layer = LayerFollower::kDefaultMaxTiles;
};

struct FollowedLayer {
  LayerId id;
  LayerEpoch epoch;
  uint64_t revision = 0;  // of the digest with which it was in sync last
  size_t tiles = 0;
  bool is_equal = false;  // to what its owner had published at the last digest
  bool in_sync = false;   // nothing of then is missing, and the owner still speaks
  // Since the digest with which it was in sync last, and of what that left out; infinity where
  // there was none. What is shown is no older than that.
  double staleness_ms = 0;
  LayerFollower::Counts counts;
};

// A copy of the map that daemons publish, made of their messages alone, from a bus or a log. The
// layer of an owner that is silent stays; after 10 s it is forgotten if another one of the same
// name is in sync: a robot that began a new map. Without threads and sockets of its own.
// Thread-compatible.
class MapFollower {
 public:
  // `seed`: see LayerFollower.
  MapFollower(FollowOptions options, uint64_t seed);

  // Those that HandleMessage() wants.
  std::vector<std::string> Channels() const;
  std::string PullChannel() const { return options_.channel_prefix + "_PULLS"; }

  // Any bytes of any of them.
  void HandleMessage(absl::Span<const uint8_t> message, Clock::time_point now);

  // What is to be published on PullChannel() now. Call it some times a second.
  std::vector<layer_pull_t> Tick(Clock::time_point now);

  // Empty until the first layer was heard. Costs what changed.
  std::shared_ptr<const MapSnapshot> Snapshot();
  // Of each layer the state in which a digest matched for the last time, without layers where none
  // has. Costs the whole map.
  std::shared_ptr<const MapSnapshot> WholeSnapshot() const;

  std::vector<FollowedLayer> Layers(Clock::time_point now) const;

  int64_t bytes_received() const { return bytes_received_; }
  int64_t malformed() const { return malformed_; }
  // Robots whose layers are not followed: another knot interval or other limits than the first
  // layer's, another version of the protocol, too many layers.
  const std::vector<std::string>& refused() const { return refused_; }

 private:
  void TakeDigest(const layer_digest_t& digest, Clock::time_point now);
  LayerFollower* Find(const layer_epoch_t& layer);
  void ForgetReplaced(const LayerId& speaker, Clock::time_point now);
  void Refuse(const std::string& name);

  const FollowOptions options_;
  uint64_t seed_;
  std::optional<MapOptions> map_options_;
  std::map<LayerId, LayerFollower> layers_;  // in an order that is the same for every follower
  std::vector<std::string> refused_;
  MergedTiles merged_;
  int64_t bytes_received_ = 0;
  int64_t malformed_ = 0;
};

}  // namespace splinemap
