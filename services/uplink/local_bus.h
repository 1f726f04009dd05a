#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/base/mutex.h"
#include "lib/replication/map_follower.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/layer_set.h"

namespace splinemap {

struct LocalBusOptions {
  std::string lcm_url;  // empty: LCM's default
  std::string channel_prefix = "SPLINEMAP";
  std::shared_ptr<const KeyRing> keys;
  std::string robot;                // whose layer goes to the fleet
  std::vector<std::string> others;  // robots, or patterns, whose layers come from it
};

// The robot's side of the uplink: follows the robot's layer on its bus, and stands in there for
// robots whose layers the fleet has. In a thread of its own. Thread-safe.
class LocalBus {
 public:
  // Waits for the robot's daemon until `is_over` says so: Cancelled. `on_change` is called by the
  // thread after changes of the robot's layer.
  static absl::StatusOr<std::unique_ptr<LocalBus>> Open(const LocalBusOptions& options,
                                                        const std::function<bool()>& is_over,
                                                        std::function<void()> on_change);
  ~LocalBus();

  const MapOptions& map_options() const { return map_options_; }
  const std::string& robot() const { return options_.robot; }

  // The robot's layer as its daemon had it at the last digest; nothing before the first. Where the
  // daemon has begun another one, that.
  std::optional<LayerSnapshot> OwnLayer() const;

  // Layers and settings of the fleet's map, as they are now.
  void UseFleet(const LayerSet& fleet);

  // The fleet knows a later session of the robot's layer than the daemon is in, since its map file
  // is an older copy. The daemon is told, until it begins a later one.
  void TellLaterSession(const LayerId& id, const SessionId& session);

  // Why the bus does not work at the moment, and robots whose layers are not followed.
  std::string Problem() const;

 private:
  LocalBus(LocalBusOptions options, std::unique_ptr<LcmBus> bus, const MapOptions& map_options,
           std::function<void()> on_change);

  void Run(const std::stop_token& stop);
  std::vector<ReplicationMessage> Tick(Clock::time_point now);
  void TakeFromFleet(Clock::time_point now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void FindOwnLayer() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const LocalBusOptions options_;
  const std::unique_ptr<LcmBus> bus_;
  const MapOptions map_options_;
  const std::function<void()> on_change_;
  const uint64_t speaker_;
  mutable Mutex mutex_;
  MapFollower follower_ ABSL_GUARDED_BY(mutex_);
  ByteBudget budget_ ABSL_GUARDED_BY(mutex_);
  Clock::time_point next_look_ ABSL_GUARDED_BY(mutex_);
  std::optional<LayerSnapshot> own_ ABSL_GUARDED_BY(mutex_);
  LayerSet fleet_ ABSL_GUARDED_BY(mutex_);
  Clock::time_point next_fleet_ ABSL_GUARDED_BY(mutex_);  // to take what was refused
  struct State {
    SessionId session;
    uint64_t version = 0;  // of its tiles
    bool operator==(const State&) const = default;
  };
  std::map<LayerId, State> adopted_ ABSL_GUARDED_BY(mutex_);
  struct LaterSession {
    LayerRef ref;
    Clock::time_point next;
  };
  std::optional<LaterSession> later_session_ ABSL_GUARDED_BY(mutex_);
  std::jthread following_;
};

}  // namespace splinemap
