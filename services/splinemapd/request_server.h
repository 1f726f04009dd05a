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

// Replies to the requests of clients, in one thread at a time: answers queries, and has commands
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

  // Any bytes of any of them. Does not wait; somebody has to look after NeedsServer() then.
  void Handle(absl::Span<const uint8_t> message);
  // Whether requests wait, and no thread is about to serve them.
  bool NeedsServer() const;
  // Serves what waits until nothing does, where NeedsServer().
  void Serve();

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
  struct Refusal {
    QueuedRequest request;  // its bytes as far as its type
    absl::Status why;
  };
  // The state of the map from which the requests of one query are answered.
  struct PinnedMap {
    RequestLine line;
    int64_t client = 0;
    int64_t query = 0;
    Clock::time_point last_used;
    // Null as long as that is what newest_map_ has.
    std::shared_ptr<const LocalMap> map;
  };
  using CommandId = std::pair<int64_t, int64_t>;  // client, id of its request
  struct ExecutedCommand {
    CommandId id;
    std::vector<uint8_t> reply;
  };

  void Refuse(const request_t& header, absl::Span<const uint8_t> message, absl::Status why)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsToServe() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return !is_stopped_ && (!queue_.empty() || !refusals_.empty());
  }
  void ServeNext();
  void AnswerQuery(const QueuedRequest& request);
  void ExecuteCommand(const QueuedRequest& request);
  absl::Status CheckSigner(absl::Span<const uint8_t> command) const;
  void RefuseSigner(const request_t& header, const absl::Status& why);
  void ReplyToCommand(const request_t& header, const absl::Status& status);
  // Valid until the next call.
  const LocalMap& MapFor(const QueuedRequest& request);
  void UseNewest();
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
  std::deque<Refusal> refusals_ ABSL_GUARDED_BY(mutex_);
  Counts counts_ ABSL_GUARDED_BY(mutex_);
  std::vector<CommandId> executing_ ABSL_GUARDED_BY(mutex_);
  std::deque<ExecutedCommand> executed_ ABSL_GUARDED_BY(mutex_);  // the last ones
  WorkSteps steps_;
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  // While no thread serves.
  std::optional<WorkSteps::Waiting> waiting_ ABSL_GUARDED_BY(mutex_){std::in_place, steps_};
  // Of the thread that serves.
  absl::flat_hash_set<CommandId> signed_commands_;  // that were executed
  LocalMap newest_map_;
  std::deque<PinnedMap> pinned_;  // the last used last
};

}  // namespace splinemap
