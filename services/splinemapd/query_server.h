#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/query/local_map.h"
#include "lib/rpc/messages.h"
#include "services/splinemapd/request_queue.h"

namespace splinemap {

// Who replies to clients, and with which map.
struct Service {
  using TakeSnapshot = std::function<std::shared_ptr<const MapSnapshot>()>;
  using Send = std::function<void(const std::string& channel, absl::Span<const uint8_t> reply)>;

  std::string channel_prefix;
  uint64_t daemon_nonce = 0;  // of this start of the daemon, not 0
  size_t layer = 0;           // of the snapshots: the daemon's own
  TakeSnapshot take_snapshot;
  Send send;

  // Of a reply that says how the map is now.
  reply_t HeadFor(const request_t& request) const;
  // A request is for another daemon.
  bool IsForOther(const request_t& request) const {
    return request.daemon_nonce != 0 && static_cast<uint64_t>(request.daemon_nonce) != daemon_nonce;
  }
  void Reply(const request_t& request, absl::Span<const uint8_t> reply) const {
    send(ReplyChannel(channel_prefix, static_cast<uint64_t>(request.client)), reply);
  }
};

// Answers queries in a thread of its own, so that the map never waits for who asks it. What exceeds
// the queue is refused with RESOURCE_EXHAUSTED, once for each request that is served, else not
// answered. Thread-safe.
class QueryServer {
 public:
  explicit QueryServer(Service service);

  static std::vector<std::string> Channels(const std::string& channel_prefix);

  // Any bytes of any of them. Does not wait.
  void TakeRequest(absl::Span<const uint8_t> message);

  struct Counts {
    int64_t taken = 0;
    int64_t malformed = 0;
    int64_t for_others = 0;  // of another nonce, ignored
    int64_t refused = 0;     // beyond the queue or the size of a message
  };
  Counts counts() const;

 private:
  struct Refusal {
    QueuedRequest request;  // its bytes as far as its type
    absl::Status why;
  };
  // The state of the map from which the requests of one query are answered.
  struct Pin {
    int64_t client = 0;
    int64_t query = 0;
    std::chrono::steady_clock::time_point last_used;
    std::shared_ptr<const LocalMap> map;
  };

  void Refuse(const request_t& head, absl::Span<const uint8_t> message, absl::Status why)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Serve(const std::stop_token& stop);
  void Answer(const QueuedRequest& request);
  std::shared_ptr<const LocalMap> MapFor(const request_t& head);

  const Service service_;
  mutable Mutex mutex_;
  ConditionVariable taken_;
  RequestQueue queue_ ABSL_GUARDED_BY(mutex_);
  std::deque<Refusal> refusals_ ABSL_GUARDED_BY(mutex_);
  Counts counts_ ABSL_GUARDED_BY(mutex_);
  // Of the thread.
  std::shared_ptr<LocalMap> newest_;
  std::deque<Pin> pins_;  // the last used last
  std::jthread serving_;
};

}  // namespace splinemap
