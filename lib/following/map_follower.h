#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/types/span.h"
#include "lcmtypes/splinemap/control_records_t.hpp"
#include "lib/map/detail.h"
#include "lib/map/map.h"
#include "lib/map/region.h"
#include "lib/replication/control_gossip.h"
#include "lib/replication/layer_follower.h"
#include "lib/replication/stand_in.h"

namespace splinemap {

// Which layers to follow, and what of them.
struct FollowOptions {
  std::string channel_prefix = "SPLINEMAP";
  std::vector<std::string> names;  // of robots, or patterns with * ? [..]; empty: all
  std::optional<Region> region;    // in the map frame; none: all of the map
  // Coarser levels are made by the daemons while somebody follows them: smoothed values, or the
  // least or greatest log-odds of the squares of 2^level x 2^level control points, so that
  // obstacles stay. The knot interval of the copy is 2^level times the map's. Control point (i, j)
  // stands for finer ones from (i, j) 2^level on. Shifts of layers are rounded to knots of the
  // level.
  Detail detail;
  // Whether decisions about layers are taken from the bus, and passed on. Else those that were
  // there at the beginning stay, and nobody on the bus can mute, shift or remove a layer here.
  bool takes_decisions = true;
  // Of all layers together, 2 KiB each; what is beyond is left out, and layers are not in sync.
  size_t max_tiles = size_t{1} << 20;
};

// Whether one of FollowOptions::names wants this robot.
bool MatchesName(const std::string& pattern, const std::string& name);

// What makes a follower one that keeps the map for others, as daemons do.
struct Keeper {
  MapOptions map_options;
  LayerId own_layer;  // never followed
  uint64_t daemon_nonce = 0;
  PublisherOptions publisher;  // bytes_per_s: of all layers that it stands in for
  uint64_t own_incarnation = 0;
};

struct FollowedLayer {
  LayerId id;
  LayerEpoch epoch;
  uint64_t revision = 0;  // of the digest with which it was in sync last
  size_t tiles = 0;
  uint64_t hash = 0;      // as in digests
  bool is_equal = false;  // to what was published at the last digest
  bool in_sync = false;   // nothing of then is missing, and its owner or a stand-in still speaks
  // Since the digest with which it was in sync last, and of what that left out; infinity where
  // there was none. What is shown is no older than that.
  double staleness_ms = 0;
  double heard_s_ago = -1;  // its owner; -1: not yet in this life
  bool owner_is_silent = false;
  LayerFollower::Counts counts;
};

// A copy of the map that daemons publish, made of their messages alone, from a bus or a log, and
// summed as people have decided. The layer of an owner that is silent stays. It is forgotten after
// 10 s if it has no tiles; and, unless this is a keeper, if nobody stands in for the owner and
// another layer of the same name is in sync: a robot that began a new map. Who keeps nothing takes
// knot interval and limits from most of the layers of which it has heard of late, and begins anew
// when they change. Stands in for silent owners, which is left to keepers where there are any.
// Without threads and sockets of its own. Thread-compatible.
class MapFollower {
 public:
  using Message = std::variant<layer_pull_t, layer_updates_t, layer_listing_t, stand_in_digest_t,
                               control_records_t>;

  // `seed`: see LayerFollower.
  MapFollower(FollowOptions options, uint64_t seed);
  // Begins with the layers of `kept`, but for its own, and with its controls. Requires that all of
  // the map is followed as it was mapped.
  MapFollower(FollowOptions options, Keeper keeper, const MapSnapshot& kept, uint64_t seed,
              Clock::time_point now);

  // What HandleMessage() wants.
  std::vector<std::string> Channels() const;

  // Any bytes of any of them.
  void HandleMessage(absl::Span<const uint8_t> message, Clock::time_point now);

  // What is to be published now, on the channels that ChannelOf() says. Call it some times a
  // second.
  std::vector<Message> Tick(Clock::time_point now);

  // Empty until the first layer was heard. Costs what changed.
  std::shared_ptr<const MapSnapshot> Snapshot();
  // Of each layer the state in which a digest matched for the last time, without layers where none
  // has. Costs the whole map.
  std::shared_ptr<const MapSnapshot> WholeSnapshot() const;
  // Those of Snapshot().
  std::vector<LayerSnapshot> LayerSnapshots();

  // Counts on when one of these or the controls change.
  uint64_t version() const;

  std::vector<FollowedLayer> Layers(Clock::time_point now) const;

  const LayerControls& controls() const { return gossip_.controls(); }
  // Those that are worth keeping on a disk.
  LayerControls LastingControls() const { return gossip_.LastingControls(); }
  // Decisions from the bus that cannot be.
  int64_t refused_decisions() const { return gossip_.refused(); }
  // Decisions from the bus that are not taken, though they would change something.
  int64_t ignored_decisions() const { return ignored_decisions_; }
  // Tells everybody; takes effect here at once.
  void Decide(const LayerId& id, const LayerControl& control);

  // A keeper that goes on as another layer, or in another start.
  void SetOwnLayer(LayerId id, uint64_t incarnation);

  int64_t bytes_received() const { return bytes_received_; }
  int64_t malformed() const { return malformed_; }
  bool is_full() const { return NumTiles() >= options_.max_tiles; }
  // Robots whose layers are not followed, and why: another knot interval or other limits than the
  // first layer's, another version of the protocol, too many layers.
  std::vector<std::string> refused() const;

 private:
  struct Followed {
    LayerFollower copy;
    std::unique_ptr<StandIn> stand_in;  // of all of a layer as it was mapped
  };

  bool IsWanted(const LayerLife& life, int32_t protocol_version);
  LayerFollower* FindOrAdd(const layer_digest_t& digest, Clock::time_point now);
  void ChooseOptions(const LayerId& id, const MapOptions& options, Clock::time_point now);
  bool MakeRoom(Clock::time_point now);
  std::optional<uint64_t> IncarnationOf(const LayerId& id) const;
  void TakeDigest(const layer_digest_t& digest, Clock::time_point now);
  void TakeStandInDigest(const stand_in_digest_t& stand_in, Clock::time_point now);
  void TakePull(const layer_pull_t& pull, Clock::time_point now);
  bool IsOwnListing(absl::Span<const uint8_t> message) const;
  Followed* Find(const layer_epoch_t& layer);
  LayerFollower::Part PartFor(const LayerId& id) const;
  void Add(const LayerId& id, LayerFollower copy);
  LayerControls SummedControls() const;
  void ObeyControls(const LayerControls& before);
  bool HasNamesake(const LayerId& id) const;
  void ForgetReplaced(const LayerId& speaker, Clock::time_point now);
  void Refuse(const LayerId& id, std::string why);
  size_t NumTiles() const;
  // Returns the next one.
  std::map<LayerId, Followed>::iterator Erase(std::map<LayerId, Followed>::iterator layer);

  const FollowOptions options_;
  std::optional<Keeper> keeper_;
  const uint64_t nonce_;  // as one that stands in
  uint64_t seed_;
  std::optional<MapOptions> map_options_;
  struct Told {
    MapOptions options;
    Clock::time_point when;
  };
  std::map<LayerId, Told> told_;        // the options of layers, by digests of late
  std::map<LayerId, Followed> layers_;  // in an order that is the same for every follower
  ControlGossip gossip_;
  std::map<LayerId, std::string> refused_;         // why
  std::deque<std::vector<uint8_t>> own_listings_;  // that it told as a stand-in, of late
  MergedTiles merged_;
  uint64_t version_ = 0;  // beside those of layers_
  int64_t bytes_received_ = 0;
  int64_t malformed_ = 0;
  int64_t ignored_decisions_ = 0;
};

}  // namespace splinemap
