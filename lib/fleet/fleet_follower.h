#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "lib/base/clock.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_store.h"
#include "lib/fleet/layer_block.h"
#include "lib/fleet/layer_digest.h"
#include "splinemap/follow_options.h"
#include "splinemap/layer_set.h"

namespace splinemap {

// What to follow of a fleet's map.
struct FleetFollowOptions {
  std::vector<std::string> names;  // of robots, or patterns; empty: all
  std::optional<std::string> but;  // not this robot
  // Layers that have tiles in this part of the map; none: all. They are followed as a whole, since
  // a layer of which a part is missing cannot be told from one that lost it.
  std::optional<Region> region;
  // Tiles of these parts alone (fleet_key.h), of all layers; none: all. Layers that people placed
  // are followed as a whole, since their tiles lie elsewhere in the map.
  std::optional<std::set<int>> parts;
};

// A copy of a fleet's map, made of the entries of its bucket in whatever order they come. What is
// damaged, or another's, is left out and counted; the copy keeps what it had. Without threads and
// connections of its own. Thread-compatible.
class FleetFollower {
 public:
  static constexpr size_t kMaxLayers = 4096;
  static constexpr size_t kMaxLayersOfName = 16;  // whoever may write as a robot may make many
  static constexpr size_t kMaxTiles = size_t{1} << 22;  // 8 GiB

  explicit FleetFollower(FleetFollowOptions options) : options_(std::move(options)) {}

  // The filters of all that is followed. More of them as layers are found.
  std::vector<std::string> Filters() const;

  // Follows other parts from now on, and forgets the tiles of those that it followed.
  void SetParts(std::set<int> parts);

  // Whether anything was taken of the keys of a filter.
  bool Knows(const std::string& filter) const;

  // Takes an entry with its value, if it is newer than what was taken of its key.
  void Handle(const FleetEntry& entry, Clock::time_point now);
  // Takes a list of all entries of a filter, with values or without. Returns keys whose entries are
  // to be fetched, and handled: those that are news, and those that the list lacks.
  std::vector<std::string> HandleList(const std::string& filter,
                                      const std::vector<FleetEntry>& entries,
                                      Clock::time_point now);
  // Whether a key of those was handled since.
  bool Has(const std::string& key) const;
  // A key that has no entry any more.
  void HandleGone(const std::string& key, Clock::time_point now);

  // Without layers until the map's record and a digest are here.
  LayerSet Layers();
  // Counts on when that changes.
  uint64_t version() const { return version_; }
  // The map's; nothing until its record was read.
  const std::optional<MapOptions>& map_options() const { return map_options_; }
  // The layer as its owner had it when a digest matched for the last time; null where none has.
  const LayerSnapshot* Whole(const LayerId& id) const;

  std::vector<FollowedLayer> FollowedLayers(Clock::time_point now) const;
  // Whether every layer is what its digest says. Of parts alone nobody can tell: always.
  bool IsWhole() const;
  // A filter was compared, and everything that it has was taken.
  void NoteCompared(const std::string& filter);
  // Filters of the tiles of layers that are not what their digests say, and of which nothing has
  // come for some seconds: what they lack is not on its way. Each once, until something comes.
  std::vector<std::string> DrainStalled(Clock::time_point now);
  // Layers that are not followed, and why; values that cannot be, the newest of each layer.
  std::vector<std::string> Refused() const;
  int64_t malformed() const { return malformed_; }
  const SettingsTable& settings() const { return settings_; }
  // Settings of layers of which the bucket has other ones, or none: it has forgotten them.
  std::vector<LayerId> ForgottenSettings() const;

 private:
  struct Known {
    uint64_t revision = 0;
    uint64_t hash = 0;
  };
  struct Followed {
    std::optional<LayerDigest> digest;
    TileTreeEditor tiles;
    std::map<BlockKey, LayerBlock::Sum> blocks;
    LayerBlock::Sum sum;  // of them
    std::optional<LayerSnapshot> whole;
    uint64_t version = 0;
    bool matches = false;
    std::set<TileKey> gone;  // of `tiles`, which only grow, until the next snapshot
    Clock::time_point changed;
    bool has_stalled = false;
    std::string problem;
  };

  bool IsFollowed(const LayerId& id) const;
  bool IsSelected(const LayerId& id) const;
  bool IsPlaced(const LayerId& id) const;
  bool IsFollowed(const LayerId& id, BlockKey block) const;
  void ForgetOtherParts();
  bool HasRoom(const LayerId& id) const;
  void Take(const FleetEntry& entry, const FleetKey& key, Clock::time_point now);
  absl::Status TakeDigest(const FleetEntry& entry, const LayerId& id, Clock::time_point now);
  absl::Status TakeBlock(const FleetEntry& entry, const FleetKey& key, Clock::time_point now);
  absl::Status TakeSettings(const FleetEntry& entry, const LayerId& id);
  absl::Status TakeMap(const FleetEntry& entry);
  void ReplaceBlock(Followed& layer, BlockKey key, const LayerBlock& block);
  LayerSnapshot SnapshotOf(const LayerId& id, Followed& layer);
  void Compare(const LayerId& id, Followed& layer);
  bool UsesOtherOptions(const Followed& layer) const;

  FleetFollowOptions options_;
  std::optional<MapOptions> map_options_;
  std::map<std::string, Known> known_;  // what was taken, by key
  std::map<LayerId, Followed> layers_;
  SettingsTable settings_;
  std::set<LayerId> compared_placed_;  // of parts: placed layers that are here as a whole
  size_t tiles_ = 0;
  uint64_t version_ = 0;
  int64_t malformed_ = 0;
};

}  // namespace splinemap
