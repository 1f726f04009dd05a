#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "services/splinemapd/replier.h"

namespace splinemap {

// Does what clients command, one after the other in a thread of its own, each once: who sends a
// command again gets the reply that there was. Beyond a queue of 16, commands are ignored.
// Thread-safe.
class CommandServer {
 public:
  using Request = std::variant<command_request_t, layer_command_request_t>;
  // Does what it says, while its condition holds, else FailedPrecondition. Runs in the thread.
  using Do = std::function<absl::Status(const Request& request)>;

  // Without `allowed` all are refused with PermissionDenied.
  CommandServer(Replier replier, bool allowed, Do do_command);

  // Any bytes. Does not wait.
  void TakeRequest(absl::Span<const uint8_t> message);

 private:
  struct Done {
    int64_t client = 0;
    int64_t id = 0;
    std::vector<uint8_t> reply;
  };

  void Serve(const std::stop_token& stop);
  absl::Status Run(const Request& request);

  const Replier replier_;
  const bool allowed_;
  const Do do_;
  Mutex mutex_;
  ConditionVariable taken_;
  std::deque<Request> waiting_ ABSL_GUARDED_BY(mutex_);
  std::deque<Done> done_;  // of the thread; the last ones
  std::jthread serving_;
};

}  // namespace splinemap
