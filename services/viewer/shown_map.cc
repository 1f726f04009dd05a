#include "services/viewer/shown_map.h"

#include <algorithm>
#include <stop_token>
#include <thread>
#include <utility>

#include "absl/strings/str_join.h"
#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/nats_fleet_store.h"
#include "lib/mapping/past_map.h"
#include "splinemap/file.h"
#include "splinemap/local_map.h"
#include "splinemap/replica.h"

namespace splinemap {
namespace {

class MapOnBus : public ShownMap {
 public:
  explicit MapOnBus(std::unique_ptr<MapReplica> replica) : replica_(std::move(replica)) {}

  LayerSet Layers() const override { return replica_->Layers(); }
  std::shared_ptr<const MapView> View() const override { return replica_->View(); }
  const QueryableMap& map() const override { return *replica_; }
  std::vector<FollowedLayer> FollowedLayers() const override { return replica_->FollowedLayers(); }
  bool IsCaughtUp() const override { return replica_->IsCaughtUp(); }
  std::vector<std::string> Refused() const override { return replica_->Refused(); }
  std::string Problem() const override { return replica_->BusProblem(); }
  int64_t BytesReceived() const override { return replica_->BytesReceived(); }

 private:
  const std::unique_ptr<MapReplica> replica_;
};

class MapOfFleet : public ShownMap {
 public:
  MapOfFleet(std::unique_ptr<NatsFleetStore> store, std::function<void()> on_change)
      : store_(std::move(store)),
        replica_(*store_, {},
                 [on_change = std::move(on_change)](const FleetReplica&) { on_change(); }) {}

  LayerSet Layers() const override { return replica_.Layers(); }
  std::shared_ptr<const MapView> View() const override { return replica_.View(); }
  const QueryableMap& map() const override { return replica_; }
  std::vector<FollowedLayer> FollowedLayers() const override { return replica_.FollowedLayers(); }
  bool IsCaughtUp() const override { return replica_.IsCaughtUp(); }
  std::vector<std::string> Refused() const override { return replica_.Refused(); }
  std::string Problem() const override {
    const std::string lost = store_->Problem();
    return lost.empty() ? replica_.Problem() : lost;
  }
  int64_t BytesReceived() const override { return replica_.BytesReceived(); }

 private:
  const std::unique_ptr<NatsFleetStore> store_;
  const FleetReplica replica_;
};

// Makes the map of other times in a thread of its own, one at a time.
class MapInFile : public ShownMap {
 public:
  MapInFile(LayerSet set, std::function<void()> on_change)
      : now_(std::move(set)), on_change_(std::move(on_change)) {
    const absl::StatusOr<ArchiveTimes> kept = TimesOf(now_);
    if (!kept.ok()) return;
    times_ = {kept->first, kept->last, {}, {}, ""};
    making_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
  }

  LayerSet Layers() const override {
    MutexLock lock(mutex_);
    return shown_;
  }
  std::shared_ptr<const MapView> View() const override { return map_.View(); }
  const QueryableMap& map() const override { return map_; }

  std::optional<MapTimes> Times() const override {
    MutexLock lock(mutex_);
    return times_;
  }

  void ShowAt(std::optional<Utime> utime) override {
    MutexLock lock(mutex_);
    if (!times_) return;
    if (utime) utime = std::max(*utime, times_->first);
    // From the last scan on nothing is left out.
    if (utime && *utime >= times_->last) utime.reset();
    if (utime == times_->wanted) return;
    times_->wanted = utime;
    times_->problem.clear();
    is_wanted_.notify_one();
  }

 private:
  void Run(const std::stop_token& stop) {
    PastMap past(now_);
    std::optional<Utime> utime;
    while (WaitForWish(stop, utime)) {
      if (!utime) {
        Show(now_, view_now_, utime);
      } else {
        const auto is_void = [&](int64_t, int64_t) {
          return stop.stop_requested() || Times()->wanted != utime;
        };
        const absl::StatusOr<LayerSet> then = past.At(*utime, is_void);
        if (then.ok()) Show(*then, ViewOf(*then), utime);
        if (!then.ok()) Tell(then.status(), utime);
      }
      on_change_();
    }
  }

  // False at the end.
  bool WaitForWish(const std::stop_token& stop, std::optional<Utime>& utime) {
    std::unique_lock lock(mutex_);
    is_wanted_.wait(lock, stop,
                    [&] { return times_->wanted != times_->shown && times_->problem.empty(); });
    utime = times_->wanted;
    return !stop.stop_requested();
  }

  void Show(const LayerSet& set, std::shared_ptr<const MapView> view, std::optional<Utime> utime) {
    MutexLock lock(mutex_);
    shown_ = set;
    map_.Use(std::move(view));
    times_->shown = utime;
  }

  void Tell(const absl::Status& problem, std::optional<Utime> utime) {
    MutexLock lock(mutex_);
    if (times_->wanted == utime && !absl::IsCancelled(problem))
      times_->problem = ErrorText(problem);
  }

  const LayerSet now_;
  const std::shared_ptr<const MapView> view_now_ = ViewOf(now_);
  const std::function<void()> on_change_;
  mutable Mutex mutex_;
  ConditionVariable is_wanted_;
  LayerSet shown_ ABSL_GUARDED_BY(mutex_) = now_;
  LocalMap map_{view_now_};
  std::optional<MapTimes> times_ ABSL_GUARDED_BY(mutex_);  // none: the file keeps no scans
  std::jthread making_;                                    // the last, which uses the others
};

}  // namespace

absl::StatusOr<std::unique_ptr<ShownMap>> FollowMap(const std::string& lcm_url,
                                                    const FollowOptions& options,
                                                    std::function<void()> on_change) {
  SPLINEMAP_ASSIGN_OR_RETURN(
      auto replica, MapReplica::Follow(lcm_url, options,
                                       [on_change = std::move(on_change)](
                                           const MapView&, const Region&) { on_change(); }));
  return std::make_unique<MapOnBus>(std::move(replica));
}

absl::StatusOr<std::unique_ptr<ShownMap>> FollowFleet(const FleetAddress& fleet,
                                                      std::function<void()> on_change) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto store, NatsFleetStore::Connect(fleet));
  return std::make_unique<MapOfFleet>(std::move(store), std::move(on_change));
}

absl::StatusOr<std::unique_ptr<ShownMap>> OpenMap(const std::string& path,
                                                  std::function<void()> on_change) {
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadMapFile(path));
  if (!loaded.corruption.empty()) {
    return DataLoss("{} is damaged; `splinemap repair` saves what can be read: {}", path,
                    absl::StrJoin(loaded.corruption, "; "));
  }
  return std::make_unique<MapInFile>(std::move(loaded.set), std::move(on_change));
}

}  // namespace splinemap
