#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "clients/client/request_flow.h"
#include "lib/base/mutex.h"
#include "lib/map/layer_control.h"
#include "lib/query/queryable_map.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {

struct ClientOptions {
  std::string channel_prefix = "SPLINEMAP";
  std::string robot;  // empty: the first that answers
  // Of Connect() and Ask().
  std::chrono::milliseconds deadline{2000};
};

// Something about a layer for all daemons and clients.
struct LayerDecision {
  std::string command;  // "mute", "unmute", "yield", "insist", "shift", "remove"
  LayerId layer;
  uint64_t incarnation = 0;  // which is to be removed
  KnotShift shift = {};      // which is to be from now on
};

// The map of a daemon, asked over LCM. What gets lost is asked again until the deadline, and where
// the daemon is started again, that of the same robot is looked for. Each answer is of one
// revision. Thread-safe; may not be destroyed while a call is under way, nor in a callback.
//
// Errors beside those of every map: InvalidArgument for more than kMaxItems items;
// DeadlineExceeded, which says what is missing; Unavailable where that is the bus;
// ResourceExhausted with RequestFlow::kMaxRequests under way.
class MapClient : public QueryableMap {
 public:
  static constexpr size_t kMaxItems = 1'000'000;  // points, rays, .. of a query; rasters: kMaxCells

  // Finds the daemon. `url` as LCM takes it, empty for LCM's default.
  static absl::StatusOr<std::unique_ptr<MapClient>> Connect(const std::string& url,
                                                            ClientOptions options);
  // What is under way is cancelled.
  ~MapClient() override;

  // These wait, and so must not be called in a callback.
  absl::StatusOr<PointsQuery::Answer> Ask(const PointsQuery& query) const override;
  absl::StatusOr<RaysQuery::Answer> Ask(const RaysQuery& query) const override;
  absl::StatusOr<SweepsQuery::Answer> Ask(const SweepsQuery& query) const override;
  absl::StatusOr<RasterQuery::Answer> Ask(const RasterQuery& query) const override;
  absl::StatusOr<LikelihoodsQuery::Answer> Ask(const LikelihoodsQuery& query) const override;
  absl::StatusOr<DistancesQuery::Answer> Ask(const DistancesQuery& query) const override;

  using RequestId = int64_t;
  // Asks without waiting, for a year at most. `done` is called once: by the client's thread, which
  // it keeps from all other answers, or in Cancel(), in the destructor and, where the query is
  // refused, in here.
  template <typename Query>
  RequestId Start(Query query, std::chrono::milliseconds deadline,
                  std::function<void(absl::StatusOr<typename Query::Answer>)> done) const;
  // Where it is still under way, its `done` gets Cancelled.
  void Cancel(RequestId id) const;

  // Has the daemon save its map now, or begin it anew. Done at most once, and only while the layer
  // is in the start that daemon() says, else FailedPrecondition; PermissionDenied where the daemon
  // takes no commands; after DeadlineExceeded and Unavailable it may have been done or not.
  absl::Status Save(std::chrono::milliseconds deadline = std::chrono::seconds(30));
  absl::Status Clear(std::chrono::milliseconds deadline = std::chrono::seconds(30));

  // Has the daemon decide about a layer that it has, for all who hear of it. Done at most once;
  // NotFound for a layer that it does not have, FailedPrecondition for the removal of one that is
  // in another start than `incarnation`; else as above.
  absl::Status Decide(const LayerDecision& decision,
                      std::chrono::milliseconds deadline = std::chrono::seconds(30));

  // As of its last reply.
  DaemonIdentity daemon() const;

 private:
  MapClient(std::unique_ptr<LcmBus> bus, const ClientOptions& options);
  absl::Status AwaitDaemon();
  void Run(const std::stop_token& stop);
  RequestId Add(std::unique_ptr<PendingRequest> request, std::chrono::milliseconds deadline) const;
  void Publish(const std::vector<RequestFlow::Outgoing>& outgoing) const;
  void Deliver();
  template <typename Query>
  absl::StatusOr<typename Query::Answer> AskAndWait(const Query& query) const;
  absl::Status CommandMap(const std::string& command, std::chrono::milliseconds deadline);
  template <typename Request>
  absl::Status Command(Request request, std::chrono::milliseconds deadline);

  const std::unique_ptr<LcmBus> bus_;
  const std::chrono::milliseconds deadline_;
  mutable Mutex mutex_;
  mutable RequestFlow flow_ ABSL_GUARDED_BY(mutex_);
  ConditionVariable found_;
  std::jthread running_;
};

}  // namespace splinemap
