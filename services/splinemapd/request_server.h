#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/request_queue.h"
#include "services/splinemapd/work_steps.h"
#include "splinemap/key_ring.h"
#include "splinemap/local_map.h"

namespace splinemap {

// Replies to the requests of clients, in two threads at most: answers queries, and has commands
// executed, each once. Clients take turns. What exceeds the queue is refused with
// RESOURCE_EXHAUSTED, once for each request that is served, else not answered. Thread-safe.
class RequestServer {
 public:
  using Send = std::function<void(const std::string& channel, absl::Span<const uint8_t> reply)>;
  using Done = std::function<void(const absl::Status&)>;
  // Executes an encoded command; `done` may be called by any thread, then or later.
  using Execute = std::function<void(const std::vector<uint8_t>& command, Done done)>;

  // `newest` outlives it. With keys, replies are signed, and commands are executed that are signed
  // with one that may decide: each once, also where it was recorded and is sent again later.
  RequestServer(std::string channel_prefix, NewestMap& newest, Send send, Execute execute,
                std::shared_ptr<const KeyRing> keys = nullptr);

  // The channels of requests.
  static std::vector<std::string> Channels(const std::string& channel_prefix);

  // Any bytes of any of them. Does not wait; somebody has to look after TakeTask() then.
  void Handle(absl::Span<const uint8_t> message);

  struct QueuedRefusal {
    QueuedRequest request;  // its bytes as far as its type
    absl::Status why;
  };
  struct Task {
    std::optional<QueuedRequest> request;
    std::optional<QueuedRefusal> refusal;
  };
  static constexpr int kMaxServing = 2;
  // What the caller has to Serve(); nothing where nothing waits or kMaxServing threads serve.
  std::optional<Task> TakeTask();
  // Serves it, and what waits by then, until nothing does.
  void Serve(std::optional<Task> task);

  struct Counts {
    int64_t malformed = 0;
    int64_t for_others = 0;   // of another nonce, ignored
    int64_t refused = 0;      // beyond the queue or the size of a message
    int64_t disbelieved = 0;  // commands whose signature is not what it should be
    std::string why;          // the last of these
  };
  Counts counts() const;
  const WorkSteps& steps() const { return steps_; }

  // What waits is not served any more.
  void Stop();

 private:
  // The state of the map from which the requests of one query are answered.
  struct PinnedMap {
    RequestLine line;
    int64_t client = 0;
    int64_t query = 0;
    Clock::time_point last_used;
    std::shared_ptr<const LocalMap> map;
  };
  using CommandId = std::pair<int64_t, int64_t>;  // client, id of its request
  struct ExecutedCommand {
    CommandId id;
    std::vector<uint8_t> reply;
  };

  void Refuse(const request_t& header, absl::Span<const uint8_t> message, absl::Status why)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  std::optional<Task> NextTask() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void AnswerQuery(const QueuedRequest& request);
  void ExecuteCommand(const QueuedRequest& request);
  absl::Status RememberSigned(const CommandId& id);
  absl::Status CheckSigner(absl::Span<const uint8_t> command) const;
  void RefuseSigner(const request_t& header, const absl::Status& why);
  void ReplyToCommand(const request_t& header, const absl::Status& status);
  std::shared_ptr<const LocalMap> MapFor(const QueuedRequest& request);
  void UseNewest() ABSL_EXCLUSIVE_LOCKS_REQUIRED(maps_mutex_);
  reply_t HeaderFor(const request_t& request) const;
  void Reply(const request_t& request, std::vector<uint8_t> reply, bool is_signed = true) const;

  const std::string channel_prefix_;
  NewestMap& newest_;
  const uint64_t daemon_nonce_;
  const Send send_;
  const Execute execute_;
  const std::shared_ptr<const KeyRing> keys_;
  mutable Mutex mutex_;
  RequestQueue queue_ ABSL_GUARDED_BY(mutex_);
  std::deque<QueuedRefusal> refusals_ ABSL_GUARDED_BY(mutex_);
  Counts counts_ ABSL_GUARDED_BY(mutex_);
  std::vector<CommandId> executing_ ABSL_GUARDED_BY(mutex_);
  std::deque<ExecutedCommand> executed_ ABSL_GUARDED_BY(mutex_);            // the last ones
  absl::flat_hash_set<CommandId> signed_commands_ ABSL_GUARDED_BY(mutex_);  // that were executed
  WorkSteps steps_;
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  int num_serving_ ABSL_GUARDED_BY(mutex_) = 0;
  // While none serves.
  std::optional<WorkSteps::Waiting> waiting_ ABSL_GUARDED_BY(mutex_){std::in_place, steps_};
  Mutex maps_mutex_;
  std::shared_ptr<LocalMap> newest_map_ ABSL_GUARDED_BY(maps_mutex_);
  std::deque<PinnedMap> pinned_ ABSL_GUARDED_BY(maps_mutex_);  // the last used last
};

}  // namespace splinemap
