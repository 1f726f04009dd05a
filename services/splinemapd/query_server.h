#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/query/local_map.h"
#include "services/splinemapd/replier.h"
#include "services/splinemapd/request_queue.h"

namespace splinemap {

// Answers queries in a thread of its own, so that the map never waits for who asks it. What exceeds
// the queue is refused with RESOURCE_EXHAUSTED, once for each request that is served, else not
// answered. Thread-safe.
class QueryServer {
 public:
  explicit QueryServer(Replier replier);

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
    RequestLine line;
    int64_t client = 0;
    int64_t query = 0;
    Clock::time_point last_used;
    // Null as long as that is what newest_ shows.
    std::shared_ptr<const LocalMap> map;
  };

  void Refuse(const request_t& head, absl::Span<const uint8_t> message, absl::Status why)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Serve(const std::stop_token& stop);
  void Answer(const QueuedRequest& request);
  // Valid until the next call.
  const LocalMap& MapFor(const QueuedRequest& request);
  void ShowNewest();

  const Replier replier_;
  mutable Mutex mutex_;
  ConditionVariable taken_;
  RequestQueue queue_ ABSL_GUARDED_BY(mutex_);
  std::deque<Refusal> refusals_ ABSL_GUARDED_BY(mutex_);
  Counts counts_ ABSL_GUARDED_BY(mutex_);
  // Of the thread.
  LocalMap newest_;
  std::deque<Pin> pins_;  // the last used last
  std::jthread serving_;
};

}  // namespace splinemap
