#pragma once

#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/mutex.h"
#include "lib/config/config.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/notice_log.h"
#include "splinemap/key_ring.h"

namespace splinemap {

// The mapping daemon: opens the map file and starts the threads that services/splinemapd/README.md
// describes, in the order of the data. The caller's thread publishes status.
class Daemon {
 public:
  // Begins to map what comes on `bus`. The new session of the layer is on disk before anything is
  // published. Errors say what stands in the way.
  static absl::StatusOr<std::unique_ptr<Daemon>> Start(const config::Config& config,
                                                       std::unique_ptr<LcmBus> bus);
  // As Stop(), with errors logged.
  ~Daemon();

  // Checks the daemon, and publishes a status_t and a layers_t where something has changed in them
  // or somebody asked for them; see StatusReporter. Call it once a second.
  void PublishStatus();
  // What was published last; null before. Thread-safe.
  struct Published {
    status_t status;
    layers_t layers;
  };
  std::shared_ptr<const Published> published() const;
  // The name of a thread that did not get on since the last call, where there is one. For a
  // watchdog: calls are some seconds apart.
  std::optional<std::string> FindHangingThread();
  // Something that the program itself found.
  NoticeLog& notices() { return *notices_; }

  // Saves what is mapped by now, without waiting for it; the result is logged.
  void SaveNow();

  // Stops receiving, maps what was received and can be placed, saves. The status of the save.
  absl::Status Stop();

 private:
  struct Parts;
  Daemon(const config::Config& config, std::unique_ptr<LcmBus> bus,
         std::unique_ptr<NoticeLog> notices);
  absl::Status StartThreads();

  config::Config config_;
  std::shared_ptr<const KeyRing> keys_;
  std::unique_ptr<LcmBus> bus_;
  std::unique_ptr<NoticeLog> notices_;
  std::unique_ptr<Parts> parts_;
  bool is_running_ = false;
  mutable Mutex mutex_;
  std::shared_ptr<const Published> published_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace splinemap
