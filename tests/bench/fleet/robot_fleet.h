#pragma once

#include <cstdint>
#include <memory>
#include <thread>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/key_ring.h"
#include "tests/bench/speed/workload.h"
#include "tests/support/map_writer.h"
#include "tests/support/scan_mapper.h"

namespace splinemap::bench {

// Robots that map a drive and publish their layers as daemons do, all in one process, 10 scans a
// second each, at different places of the drive. A thread of its own. Thread-safe.
class RobotFleet {
 public:
  // `workload` and `bus` outlive this. They send scans, or tiles alone, and sign where there are
  // keys.
  RobotFleet(int robots, bool sends_scans, const Workload& workload, LcmBus& bus,
             std::shared_ptr<const KeyRing> keys);

  struct Totals {
    int64_t messages = 0;
    int64_t bytes = 0;  // of whole LCM messages
    int64_t changed_tiles = 0;
    int64_t late_rounds = 0;  // that began 50 ms late or more
    size_t tiles = 0;         // that the layers have
  };
  Totals totals() const;

  // No more scans; all that is asked for is still answered.
  void Rest();
  // Of each layer, as in layer_status_t.
  std::vector<int64_t> Hashes() const;

 private:
  struct Robot {
    Robot(int number, bool sends_scans, std::shared_ptr<ScanFolder> folder, size_t first_scan);

    MapWriter map;
    Layer& layer;
    ScanMapper mapper;
    PyramidPublisher publisher;
    ByteBudget budget{PublisherOptions().bytes_per_s};
    size_t next_scan;
  };

  void Run(const std::stop_token& stop);
  void MapNextScan(Robot& robot) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Publish(const std::vector<ReplicationMessage>& messages)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Workload& workload_;
  LcmBus& bus_;
  const std::shared_ptr<const KeyRing> keys_;
  mutable Mutex mutex_;
  std::vector<std::unique_ptr<Robot>> robots_ ABSL_GUARDED_BY(mutex_);
  Totals totals_ ABSL_GUARDED_BY(mutex_);
  bool is_resting_ ABSL_GUARDED_BY(mutex_) = false;
  std::jthread running_;
};

}  // namespace splinemap::bench
