#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/map/map.h"
#include "lib/replication/levels_publisher.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {

// Publishes one layer to its followers, in a thread of its own: so neither the map nor what it
// receives ever waits for them. Thread-safe.
class LayerServer {
 public:
  // What a map of the one layer is at the moment.
  using TakeSnapshot = std::function<std::shared_ptr<const MapSnapshot>()>;

  // Publishes the layer until it is destroyed, whatever life it is in. Pulls are those of
  // TakePull().
  LayerServer(LcmBus& bus, const std::string& channel_prefix, const PublisherOptions& options,
              TakeSnapshot take_snapshot);

  // A message on the channel of pulls; any bytes.
  void TakePull(absl::Span<const uint8_t> message);

  static std::string PullChannel(const std::string& channel_prefix) {
    return channel_prefix + "_PULLS";
  }

 private:
  void Serve(const std::stop_token& stop);
  void SetLayer(const MapSnapshot& map, Clock::time_point now);
  void Publish(const PublishedMessage& message);

  LcmBus& bus_;
  const std::string prefix_;
  const TakeSnapshot take_snapshot_;
  const PublisherOptions options_;
  // Of the thread; of the layer's present life.
  std::unique_ptr<LevelsPublisher> publisher_;
  LayerLife life_;

  Mutex mutex_;
  std::vector<layer_pull_t> pulls_ ABSL_GUARDED_BY(mutex_);

  std::jthread serving_;
};

}  // namespace splinemap
