#pragma once

#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/following/map_follower.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/ingest_queue.h"
#include "services/splinemapd/summed_map.h"

namespace splinemap {

// Follows the layers of other daemons, stands in for those that are silent, and keeps the decisions
// about layers, in a thread of its own. Thread-safe.
class LayerKeeper {
 public:
  // Begins with what `kept` has, and shows what it has in `sum`, which outlives it.
  LayerKeeper(LcmBus& bus, FollowOptions options, Keeper keeper, const MapSnapshot& kept,
              SummedMap& sum);

  // The channels of what Take() wants.
  std::vector<std::string> Channels() const;
  // Any bytes of any of them. Does not wait; what is too much is dropped, and asked for again.
  void Take(absl::Span<const uint8_t> message) { queue_.Push("", message); }

  // Shown at once, and told to everybody.
  void Decide(const LayerId& id, const LayerControl& control);
  LayerControls Controls() const;

  std::vector<FollowedLayer> Layers() const;
  std::vector<std::string> Refused() const;
  int64_t RefusedDecisions() const;
  int64_t IgnoredDecisions() const;
  bool IsFull() const;

  void SetOwnLayer(const LayerId& id, uint64_t incarnation);

 private:
  void Run(const std::stop_token& stop);
  void Show() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  LcmBus& bus_;
  const std::string channel_prefix_;
  SummedMap& sum_;
  IngestQueue queue_;
  mutable Mutex mutex_;
  MapFollower follower_ ABSL_GUARDED_BY(mutex_);
  std::optional<uint64_t> shown_ ABSL_GUARDED_BY(mutex_);  // version of follower_
  std::jthread running_;
};

}  // namespace splinemap
