#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/follow_options.h"
#include "splinemap/layer_set.h"
#include "splinemap/map_view.h"
#include "splinemap/queryable_map.h"
#include "splinemap/region.h"

namespace splinemap {

// A live copy of the map on a bus, kept by a thread of its own: byte for byte what the daemons have
// published, once a digest has matched. Thread-safe.
class MapReplica : public QueryableMap {
 public:
  // Called by the replica's thread after changes, some times a second: with the new map, and where
  // it may differ from the one before. What it does keeps the replica waiting.
  using OnChange = std::function<void(const MapView& map, const Region& changed)>;

  // Follows from now on. `url` as LCM takes it, empty for LCM's default.
  static absl::StatusOr<std::unique_ptr<MapReplica>> Follow(const std::string& url,
                                                            FollowOptions options,
                                                            OnChange on_change = {});
  ~MapReplica() override;

  // The map at the moment; empty until the first layer was received. Never waits for the bus.
  std::shared_ptr<const MapView> View() const;
  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override;

  // The layers at the moment, and each in the state in which a digest matched for the last time.
  LayerSet Layers() const;
  LayerSet SyncedLayers() const;
  // Those that are here, and those that a daemon has and nobody has digested yet.
  std::vector<FollowedLayer> FollowedLayers() const;
  // Whether all that anybody on the bus has is here, of the layers that are followed. False for the
  // first 2 s, in which the replica asks who is there.
  bool IsCaughtUp() const;
  // Robots whose layers are not followed, and why.
  std::vector<std::string> Refused() const;
  // Where there are keys: how many messages are not believed, and why.
  std::vector<std::string> Disbelieved() const;
  int64_t BytesReceived() const;
  // Why the bus does not work at the moment, and what to do; empty while it does.
  std::string BusProblem() const;

 private:
  class Impl;
  explicit MapReplica(std::unique_ptr<Impl> impl);

  const std::unique_ptr<Impl> impl_;
};

}  // namespace splinemap
