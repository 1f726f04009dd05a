#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/mutex.h"
#include "lib/config/config.h"
#include "lib/map/map.h"
#include "lib/pipeline/mapper.h"
#include "lib/store/map_file.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/ingest_queue.h"

namespace splinemap {

// The mapping daemon: one thread receives, one maps, one saves. The caller's thread publishes
// status.
class Daemon {
 public:
  // Opens the map file and begins to map what comes on `bus`. The new incarnation of the layer is
  // on disk before anything is published. Errors say what stands in the way.
  static absl::StatusOr<std::unique_ptr<Daemon>> Start(const config::Config& config,
                                                       std::unique_ptr<LcmBus> bus);

  // As Stop(), with errors logged.
  ~Daemon();

  // Publishes a splinemap.status_t. Call it once a second.
  void PublishStatus();

  // Stops receiving, maps what was received and can be placed, saves. The status of the save.
  absl::Status Stop();

 private:
  Daemon(const config::Config& config, std::unique_ptr<LcmBus> bus, MapFile file);
  absl::Status OpenMap();

  void Receive(std::stop_token stop);
  void MapMessages(std::stop_token stop);
  void MapOne(const IngestedMessage& message);
  void SaveNowAndThen(std::stop_token stop);
  absl::Status Save();
  void LogNotices();
  status_t Status();

  struct ScanTimes {
    int64_t scans = 0;
    std::chrono::nanoseconds total{0};
    std::chrono::nanoseconds longest{0};
  };

  config::Config config_;
  const std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
  std::unique_ptr<LcmBus> bus_;
  IngestQueue ingest_;

  Mutex map_mutex_;  // held while one message is mapped, and while a snapshot is taken
  std::unique_ptr<Map> map_ ABSL_GUARDED_BY(map_mutex_);
  Layer* layer_ ABSL_GUARDED_BY(map_mutex_) = nullptr;
  std::unique_ptr<Mapper> mapper_ ABSL_GUARDED_BY(map_mutex_);
  ScanTimes scan_times_ ABSL_GUARDED_BY(map_mutex_);  // since the last status
  std::chrono::steady_clock::time_point last_mapped_ ABSL_GUARDED_BY(map_mutex_);
  std::string last_problem_ ABSL_GUARDED_BY(map_mutex_);

  Mutex file_mutex_;
  MapFile file_ ABSL_GUARDED_BY(file_mutex_);
  std::optional<uint64_t> saved_revision_ ABSL_GUARDED_BY(map_mutex_);

  std::jthread saving_;
  std::jthread mapping_;
  std::jthread receiving_;
};

}  // namespace splinemap
