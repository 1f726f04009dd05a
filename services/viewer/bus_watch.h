#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/replica/caller.h"
#include "lib/replication/admission.h"
#include "lib/wire/lcm_bus.h"
#include "services/viewer/placed_scans.h"
#include "splinemap/layer.h"
#include "splinemap/pose2.h"

namespace splinemap {

// Which channels are shown beside the map.
struct WatchOptions {
  std::string channel_prefix = "SPLINEMAP";
  std::shared_ptr<const KeyRing> keys;  // null: none
  std::vector<std::string> poses;       // empty: all that carry poses
  std::vector<config::Scan> scans;
  std::vector<std::string> paths;  // empty: all that carry paths
};

template <typename Value>
struct Heard {
  Value value;
  Clock::time_point time;
};

// A layer as the daemon says that knows it best.
struct BusLayer {
  layer_status_t status;
  std::string daemon;
};

// The newest of everything that is shown beside the map, by channel or name.
struct BusState {
  static constexpr size_t kMaxKeys = 256;  // of each kind

  std::map<std::string, Heard<Pose2>> poses;
  std::map<std::string, Heard<ShownScan>> scans;
  std::map<std::string, Heard<std::vector<Eigen::Vector2d>>> paths;  // in metres
  std::map<int64_t, Heard<status_t>> daemons;                        // by nonce
  std::map<LayerId, Heard<BusLayer>> layers;
  // From the frame of its owner's poses to that of the layer, as the owner says.
  std::map<LayerId, Heard<Pose2>> frames;
};

// Listens to a bus in a thread of its own. Thread-safe.
class BusWatch {
 public:
  // `on_news` runs in the thread of the watch.
  static absl::StatusOr<std::unique_ptr<BusWatch>> Start(const std::string& lcm_url,
                                                         const WatchOptions& options,
                                                         std::function<void()> on_news);
  ~BusWatch();

  BusState State() const;
  // As Caller::Tick(): daemons tell their state once a second while this is called.
  void Call();
  // Sends a goal as a pose_xyt_t.
  void PublishGoal(const std::string& channel, const Pose2& goal);

 private:
  BusWatch(std::unique_ptr<LcmBus> bus, const WatchOptions& options, std::function<void()> on_news);

  void Run(const std::stop_token& stop);
  void HandleMessage(const std::string& channel, absl::Span<const uint8_t> message);
  void HandleStatus(absl::Span<const uint8_t> message);
  void HandleLayers(absl::Span<const uint8_t> message);
  void HandlePose(const std::string& channel, absl::Span<const uint8_t> message);
  void HandlePath(const std::string& channel, absl::Span<const uint8_t> message);
  bool IsShown(const std::vector<std::string>& channels, const std::string& channel) const;

  const WatchOptions options_;
  const std::function<void()> on_news_;
  const std::unique_ptr<LcmBus> bus_;
  Admission admission_;  // of its thread
  PlacedScans scans_;
  mutable Mutex mutex_;
  Caller caller_ ABSL_GUARDED_BY(mutex_);
  BusState state_ ABSL_GUARDED_BY(mutex_);
  std::jthread watching_;
};

}  // namespace splinemap
