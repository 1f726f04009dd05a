#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lib/map/summed_layers.h"
#include "lib/mapping/scan_folder.h"
#include "lib/replication/admission.h"
#include "lib/replication/coarser_copy.h"
#include "lib/replication/layer_follower.h"
#include "lib/replication/proxy_publisher.h"
#include "lib/replication/replication_message.h"
#include "lib/replication/settings_gossip.h"
#include "splinemap/follow_options.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/region.h"

namespace splinemap {

// Whether one of FollowOptions::names wants this robot.
bool MatchesName(const std::string& pattern, const std::string& name);

// What makes a follower one that keeps the map for others, as daemons do.
struct KeeperOptions {
  MapOptions map_options;
  LayerId own_layer;  // never followed
  uint64_t own_session_number = 0;
  std::chrono::milliseconds digest_interval{1000};
};

// A copy of the map that daemons publish, made of their messages alone, from a bus or a log, and
// summed as people have decided. The layer of an owner that is silent stays. It is forgotten after
// 10 s if it has no tiles; and, unless this is a keeper, if nobody is a proxy for the owner and
// another layer of the same name is in sync: a robot that began a new map. Who keeps nothing takes
// knot interval and limits from most of the layers of which it has heard of late, and begins anew
// when they change. Stands in for silent owners, which is left to keepers where there are any.
// Without threads and sockets of its own. Thread-compatible.
class MapFollower {
 public:
  // `speaker` are random bits of this process.
  MapFollower(FollowOptions options, uint64_t speaker);
  // Begins with the layers of `kept`, but for its own, and with its settings. Requires that all of
  // the map is followed as it was mapped.
  MapFollower(FollowOptions options, KeeperOptions keeper, const LayerSet& kept, uint64_t speaker,
              Clock::time_point now);

  // A message of ReplicationChannels(). False for those of its own speaker, which are ignored.
  bool Handle(const ReplicationMessage& message, Clock::time_point now);
  // The same for any bytes.
  void HandleBytes(absl::Span<const uint8_t> message, Clock::time_point now);

  // What is to be published now. Call it some times a second, or at NextTick().
  std::vector<ReplicationMessage> Tick(Clock::time_point now, ByteBudget& budget);
  // What the budget is for: answers of proxies.
  bool HasPulls() const;
  // When Tick() will have something to do, if nothing comes before.
  Clock::time_point NextTick(Clock::time_point now) const;

  // Empty until the first layer was heard. Costs what changed.
  LayerSet Layers();
  std::shared_ptr<const MapView> View() { return sum_.Update(Layers()); }
  // Of each layer the state in which a digest matched for the last time, without layers where none
  // has. Costs the whole map.
  LayerSet SyncedLayers() const;

  // Counts on when one of these or the settings change.
  uint64_t version() const;

  // Those that are here, and those that a daemon has and nobody has digested yet.
  std::vector<FollowedLayer> FollowedLayers(Clock::time_point now) const;
  // Whether all that anybody has is here: false while this asks who is there, at the beginning.
  bool IsCaughtUp(Clock::time_point now) const;

  // Takes a copy of a layer that came another way than over this bus, as if its owner had been
  // silent since; this stands in for it then. False where it is not taken: its owner is heard, or
  // in a later session, or it is not followed.
  bool Adopt(const LayerSnapshot& layer, Clock::time_point now);

  const SettingsTable& settings() const { return gossip_.settings(); }
  // Those that are worth keeping on a disk.
  SettingsTable LastingSettings() const { return gossip_.LastingSettings(); }
  // Settings from the bus that cannot be.
  int64_t refused_settings() const { return gossip_.refused(); }
  // Settings from the bus that are not taken, though they would change something.
  int64_t ignored_settings() const { return ignored_settings_; }
  // Tells everybody; takes effect here at once.
  void Set(const LayerId& id, const LayerSettings& setting);
  uint64_t speaker() const { return speaker_; }

  // A keeper that continues as another layer, or in another session.
  void SetOwnLayer(LayerId id, uint64_t session_number);

  int64_t bytes_received() const { return bytes_received_; }
  int64_t malformed() const { return malformed_ + admission_.malformed(); }
  // Of HandleBytes().
  const Admission& admission() const { return admission_; }
  bool is_full() const { return NumTiles() >= options_.max_tiles; }
  // Robots whose layers are not followed, and why: another knot interval or other limits than the
  // first layer's, another version of the protocol, too many layers.
  std::vector<std::string> refused() const;

 private:
  struct Followed {
    LayerFollower copy;
    std::unique_ptr<ProxyPublisher> proxy;  // of all of a layer as it was mapped
    std::optional<CoarserCopy> coarser{};   // where a coarser level is made of the copy
  };

  bool IsFollowed(const LayerId& id) const;
  bool IsWanted(const LayerRef& ref, int32_t protocol_version);
  LayerFollower* FindOrAdd(const layer_digest_t& digest, Clock::time_point now);
  void ChooseOptions(const LayerId& id, const MapOptions& options, Clock::time_point now);
  bool MakeRoom(Clock::time_point now);
  std::optional<uint64_t> SessionNumberOf(const LayerId& id) const;
  void Handle(const layer_digest_t& digest, Clock::time_point now);
  void Handle(const layer_updates_t& updates, Clock::time_point now);
  void Handle(const layer_listing_t& listing, Clock::time_point now);
  void Handle(const layer_pull_t& pull, Clock::time_point now);
  void Handle(const layer_scans_t& scans, Clock::time_point now);
  void Handle(const scan_pull_t& pull, Clock::time_point now);
  void Handle(const settings_t& settings, Clock::time_point now);
  void Handle(const layers_t& layers, Clock::time_point now);
  LayerFollower* CopyOf(const layer_ref_t& layer);
  void ShareTiles(LayerFollower& copy) const;
  Followed* Find(const layer_ref_t& layer);
  // Whether levels of detail are made here, of layers that are followed as they were mapped.
  bool MakesLevels() const {
    return options_.level_of_detail != LevelOfDetail{} && !options_.takes_tiles;
  }
  // Of the level of detail.
  std::optional<TileBox> BoxFor(const LayerId& id) const;
  LayerFollower::Subset SubsetFor(const LayerId& id) const;
  LayerFollower NewCopy(const LayerId& id);
  void UseOptions(const MapOptions& options);
  void Add(const LayerId& id, LayerFollower copy);
  void ApplySettings(const SettingsTable& before);
  bool HasDuplicateName(const LayerId& id) const;
  void ForgetReplaced(const LayerId& speaker, Clock::time_point now);
  void Refuse(const LayerId& id, std::string why);
  size_t NumTiles() const;
  // Returns the next one.
  std::map<LayerId, Followed>::iterator Erase(std::map<LayerId, Followed>::iterator layer);

  const FollowOptions options_;
  std::optional<KeeperOptions> keeper_;
  const uint64_t speaker_;
  Admission admission_;
  uint64_t seed_;
  std::optional<MapOptions> map_options_;
  std::shared_ptr<ScanFolder> folder_;  // of all layers; null where tiles are taken
  struct Told {
    MapOptions options;
    Clock::time_point when;
  };
  std::map<LayerId, Told> told_;  // the options of layers, by digests of late
  // What daemons have said of late that they have.
  struct Announced {
    SessionId session;
    Clock::time_point when;
  };
  std::map<LayerId, Announced> announced_;
  std::map<LayerId, Followed> layers_;  // in an order that is the same for every follower
  SettingsGossip gossip_;
  std::map<LayerId, std::string> refused_;  // why
  SummedLayers sum_;
  uint64_t version_ = 0;  // beside those of layers_
  int64_t bytes_received_ = 0;
  int64_t malformed_ = 0;
  int64_t ignored_settings_ = 0;
  int calls_ = 0;  // at the beginning
  Clock::time_point next_call_;
};

}  // namespace splinemap
