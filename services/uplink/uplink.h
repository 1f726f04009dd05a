#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/base/mutex.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/fleet_file.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/layer_upload.h"
#include "lib/fleet/nats_fleet_store.h"
#include "services/uplink/local_bus.h"
#include "services/uplink/pace.h"
#include "splinemap/region.h"

namespace splinemap {

struct UplinkOptions {
  LocalBusOptions bus;
  FleetAddress fleet;
  std::optional<Region> region;  // of the layers of others; none: wherever they are
  double max_kb_per_s = 100;     // to the fleet
  std::string map_file;          // of the daemon, whose copies go to the fleet; empty: none do
  // After a digest, changes are gathered for so long.
  std::chrono::milliseconds interval{2000};
};

// Brings the layer of a robot to its fleet, and those of others to its bus. The robot's daemon
// knows nothing of it. Thread-safe.
class Uplink {
 public:
  // Errors: those of LocalBus::Open(). Servers that do not answer are looked for; `is_over` says
  // when to end meanwhile. PermissionDenied and InvalidArgument as NatsFleetStore::Connect().
  static absl::StatusOr<std::unique_ptr<Uplink>> Start(const UplinkOptions& options,
                                                       const std::function<bool()>& is_over);
  ~Uplink();

  struct State {
    std::string problem;  // why it does not get on, and what to do; empty while it does
    LayerId layer;
    uint64_t revision_here = 0;
    uint64_t revision_there = 0;  // of the layer in the fleet, as of its last digest
    LayerUpload::Counts sent;
    int64_t files = 0;  // copies of the map file that are whole there
    size_t layers_of_others = 0;
    int64_t bytes_received = 0;
  };
  State state() const;
  // Whether the servers refuse it, so that it is over until it is started again.
  bool IsOver() const { return store_->IsClosed() || (files_ && files_->IsClosed()); }

 private:
  Uplink(UplinkOptions options, std::unique_ptr<NatsFleetStore> store,
         std::unique_ptr<NatsFleetStore> files);

  void Run(const std::stop_token& stop);
  absl::Status BringOwn(const std::stop_token& stop);
  absl::Status CheckMap();
  void BringFile(const std::stop_token& stop, Clock::time_point until);
  bool Wait(const std::stop_token& stop, Clock::time_point until);

  const UplinkOptions options_;
  const std::unique_ptr<NatsFleetStore> store_;
  const std::unique_ptr<NatsFleetStore> files_;  // null without a file
  std::unique_ptr<LocalBus> bus_;
  std::map<LayerId, LayerUpload> uploads_;  // of the thread, as what follows
  Pace pace_;
  Clock::time_point next_look_;
  Clock::time_point next_compare_;
  Clock::time_point next_file_;
  Clock::duration file_pause_;
  std::string file_copy_;                       // that is on its way; empty: none
  std::optional<FleetFileUpload> file_upload_;  // the same

  mutable Mutex mutex_;
  ConditionVariable changed_;
  bool is_changed_ ABSL_GUARDED_BY(mutex_) = false;  // the own layer
  State state_ ABSL_GUARDED_BY(mutex_);
  std::string file_problem_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<FleetReplica> replica_;
  std::jthread uploading_;
};

}  // namespace splinemap
