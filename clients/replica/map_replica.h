#pragma once

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/base/mutex.h"
#include "lib/following/map_follower.h"
#include "lib/map/region.h"
#include "lib/query/local_map.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {

// A live copy of the map on a bus, kept by a thread of its own: byte for byte what the daemons have
// published, once a digest has matched. Thread-safe.
class MapReplica : public QueryableMap {
 public:
  // Called by the replica's thread after changes, some times a second: with the new map, and where
  // it may differ from the one before. What it does keeps the replica waiting.
  using OnChange = std::function<void(const MapSnapshot& map, const Region& changed)>;

  // Follows from now on. `url` as LCM takes it, empty for LCM's default.
  static absl::StatusOr<std::unique_ptr<MapReplica>> Follow(const std::string& url,
                                                            FollowOptions options,
                                                            OnChange on_change = {});

  // The map at the moment; without layers until the first was heard. Never waits for the bus.
  std::shared_ptr<const MapSnapshot> Snapshot() const {
    MutexLock lock(snapshot_mutex_);
    return snapshot_;
  }

  absl::StatusOr<PointsQuery::Answer> Ask(const PointsQuery& query) const override {
    return local_map_.Ask(query);
  }
  absl::StatusOr<RaysQuery::Answer> Ask(const RaysQuery& query) const override {
    return local_map_.Ask(query);
  }
  absl::StatusOr<SweepsQuery::Answer> Ask(const SweepsQuery& query) const override {
    return local_map_.Ask(query);
  }
  absl::StatusOr<RasterQuery::Answer> Ask(const RasterQuery& query) const override {
    return local_map_.Ask(query);
  }
  absl::StatusOr<LikelihoodsQuery::Answer> Ask(const LikelihoodsQuery& query) const override {
    return local_map_.Ask(query);
  }
  absl::StatusOr<DistancesQuery::Answer> Ask(const DistancesQuery& query) const override {
    return local_map_.Ask(query);
  }

  // As MapFollower's.
  std::shared_ptr<const MapSnapshot> WholeSnapshot() const;

  std::vector<FollowedLayer> Layers() const;
  LayerControls Controls() const;
  std::vector<std::string> Refused() const;
  int64_t BytesReceived() const;
  // As LcmBus::Problem().
  std::string BusProblem() const { return bus_->Problem(); }

 private:
  MapReplica(std::unique_ptr<LcmBus> bus, FollowOptions options, OnChange on_change);
  void Run(const std::stop_token& stop);
  void Show(std::shared_ptr<const MapSnapshot> snapshot);

  std::unique_ptr<LcmBus> bus_;
  const OnChange on_change_;
  const std::string channel_prefix_;
  mutable Mutex mutex_;
  MapFollower follower_ ABSL_GUARDED_BY(mutex_);
  // Held for moments only, unlike mutex_.
  mutable Mutex snapshot_mutex_;
  std::shared_ptr<const MapSnapshot> snapshot_ ABSL_GUARDED_BY(snapshot_mutex_);
  LocalMap local_map_;  // of the same
  std::jthread following_;
};

}  // namespace splinemap
