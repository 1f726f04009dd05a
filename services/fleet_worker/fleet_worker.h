#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/nats_fleet_store.h"
#include "lib/fleet/sum_upload.h"
#include "lib/fleet/work_sharing.h"
#include "splinemap/layer_set.h"

namespace splinemap {

struct WorkerOptions {
  FleetAddress fleet;
  std::optional<int> replicas;            // of a bucket that is made; none: 3, or 1 on one server
  std::optional<double> knot_interval_m;  // of a map that is begun; none: 0.05
};

// Answers for some parts of a fleet's map, and publishes the sum of some of them. Others see that
// it is there, and which parts it has; it keeps nothing, and may be killed at any time. Owns
// threads: those that answer, one that publishes, and the replica's.
class FleetWorker {
 public:
  // Makes the bucket and begins the map where they are not there. Errors of NatsFleetStore;
  // FailedPrecondition where the map has another knot interval than is asked for.
  static absl::StatusOr<std::unique_ptr<FleetWorker>> Start(const WorkerOptions& options);
  ~FleetWorker();

  // To be called some times a second, by one thread.
  void Tick();

  // After ticks: whether it answers for all parts that it owns, and what about, for people.
  bool IsReady() const { return is_ready_; }
  std::string Description() const;
  // Whether the servers refuse it, so that it is over until it is started again.
  bool IsOver() const { return store_->IsClosed(); }
  // What does not work at the moment; empty while all does.
  std::string Problem() const;

 private:
  struct Request {
    std::string bytes;
    std::string reply_to;
  };

  FleetWorker(const WorkerOptions& options, std::unique_ptr<NatsFleetStore> store,
              std::unique_ptr<NatsFleetStore> files, std::unique_ptr<NatsFleetStore> sum_store);
  void Tell();
  PartSet ServedParts() const;
  void Serve(const PartSet& parts);
  void Take(Request request);
  void AnswerAll(const std::stop_token& stop);
  std::string AnswerTo(const std::string& bytes);
  void Publish(const std::stop_token& stop);
  absl::Status KeepMap();

  const WorkerOptions options_;
  const uint64_t id_;
  const std::unique_ptr<NatsFleetStore> store_;
  const std::unique_ptr<NatsFleetStore> files_;
  const std::unique_ptr<NatsFleetStore> sum_store_;
  FleetReplica replica_;

  // Of the thread that ticks.
  Clock::time_point listening_since_;
  uint64_t connections_ = 0;  // of the store, then
  Clock::time_point told_at_;
  bool is_ready_ = false;
  PartSet followed_;
  std::map<int, std::unique_ptr<FleetSubscription>> subscriptions_;
  std::unique_ptr<FleetSubscription> listening_;

  mutable Mutex mutex_;
  WorkShare share_ ABSL_GUARDED_BY(mutex_);
  PartSet served_ ABSL_GUARDED_BY(mutex_);
  uint64_t times_withdrawn_ ABSL_GUARDED_BY(mutex_) = 0;  // parts from served_
  PartSet published_ ABSL_GUARDED_BY(mutex_);
  std::string keep_problem_ ABSL_GUARDED_BY(mutex_);
  std::string publish_problem_ ABSL_GUARDED_BY(mutex_);

  Mutex requests_mutex_;
  ConditionVariable arrived_;
  std::deque<Request> requests_ ABSL_GUARDED_BY(requests_mutex_);

  std::vector<std::jthread> answering_;
  std::jthread publishing_;
};

}  // namespace splinemap
