#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_follower.h"
#include "lib/fleet/fleet_store.h"
#include "lib/map/summed_layers.h"
#include "splinemap/local_map.h"
#include "splinemap/map_view.h"
#include "splinemap/queryable_map.h"

namespace splinemap {

// A live copy of a fleet's map, or of a part of it, kept by a thread of its own. It hears of
// changes and, whenever some may have been missed and once a minute, compares hashes and fetches
// what differs. Thread-safe.
class FleetReplica : public QueryableMap {
 public:
  // Called by the replica's thread after changes, some times a second.
  using OnChange = std::function<void(const FleetReplica& replica)>;

  // Follows from now on. `store` outlives it.
  FleetReplica(FleetStore& store, FleetFollowOptions options, OnChange on_change = {});
  ~FleetReplica() override;

  std::shared_ptr<const MapView> View() const { return map_.View(); }
  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override {
    return map_.AskAny(query);
  }
  const LocalMap& map() const { return map_; }

  LayerSet Layers() const;
  // Of each layer the state in which a digest matched for the last time.
  LayerSet WholeLayers() const;
  std::optional<MapOptions> map_options() const;
  // As FleetFollower::ForgottenSettings(), with what they were; nothing while it is not compared.
  std::map<LayerId, LayerSettings> ForgottenSettings() const;
  std::vector<FollowedLayer> FollowedLayers() const;
  // Whether everything was compared: no layer of the bucket is missing here as a whole.
  bool HasCompared() const;
  // The same, and whether every layer is what its digest says. While many robots write, that is
  // seldom true of all at once.
  bool IsCaughtUp() const;
  std::vector<std::string> Refused() const;
  int64_t BytesReceived() const;
  // Why it does not get on at the moment; empty while it does.
  std::string Problem() const;

  // Has everything compared now.
  void CompareAgain();

  // Follows other parts from now on; requires options of parts. Those that are followed already are
  // not fetched again.
  void SetParts(std::set<int> parts);
  // The parts of which the map has everything that the store had when they were compared.
  std::set<int> CompleteParts() const;

 private:
  void Run(const std::stop_token& stop);
  absl::Status Compare(const std::stop_token& stop);
  absl::Status CompareFilter(const std::string& filter, const std::stop_token& stop);
  void Receive(FleetEntry entry);
  bool HasNewFilter();
  bool CompareStalled(const std::stop_token& stop);
  void Handle(const FleetEntry& entry);
  bool WaitForNews(const std::stop_token& stop);
  void Drain();
  void Publish();

  FleetStore& store_;
  const OnChange on_change_;
  LocalMap map_{std::make_shared<const MapView>()};
  SummedLayers sum_;  // of the thread

  mutable Mutex mutex_;
  mutable FleetFollower follower_ ABSL_GUARDED_BY(mutex_);
  std::string problem_ ABSL_GUARDED_BY(mutex_);
  bool is_compared_ ABSL_GUARDED_BY(mutex_) = false;
  int64_t bytes_received_ ABSL_GUARDED_BY(mutex_) = 0;
  std::set<int> parts_ ABSL_GUARDED_BY(mutex_);  // followed
  uint64_t times_parts_were_set_ ABSL_GUARDED_BY(mutex_) = 0;
  std::set<int> compared_ ABSL_GUARDED_BY(mutex_);  // of parts_
  std::set<int> complete_ ABSL_GUARDED_BY(mutex_);  // of compared_, and in map_

  Mutex inbox_mutex_;
  ConditionVariable news_;
  std::vector<FleetEntry> inbox_ ABSL_GUARDED_BY(inbox_mutex_);
  size_t inbox_bytes_ ABSL_GUARDED_BY(inbox_mutex_) = 0;
  bool compares_again_ ABSL_GUARDED_BY(inbox_mutex_) = false;

  std::map<std::string, std::unique_ptr<FleetSubscription>> subscriptions_;  // of the thread
  bool has_new_subscription_ = false;  // the same: not all servers may know of it
  uint64_t published_version_ = 0;     // the same
  std::jthread following_;
};

}  // namespace splinemap
