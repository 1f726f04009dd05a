#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <variant>
#include <vector>

#include "absl/types/span.h"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "services/splinemapd/work_steps.h"
#include "splinemap/utime.h"

namespace splinemap {

struct MailboxMessage {
  std::string channel;
  std::vector<uint8_t> bytes;
  Utime received{0};  // clock of the host
};
using Task = std::function<void()>;

// The inbox of a thread: messages of the bus and tasks of other threads, in the order in which they
// came. When more than `max_bytes` of messages wait, the oldest are dropped and counted; tasks
// never are. Thread-safe.
class Mailbox {
 public:
  using Item = std::variant<MailboxMessage, Task>;

  explicit Mailbox(size_t max_bytes) : max_bytes_(max_bytes) {}

  // Where it does not wake the thread, the message waits for the next one that does, or for the
  // thread's deadline.
  void Push(const std::string& channel, absl::Span<const uint8_t> message,
            Utime received = Utime(0), bool wakes = true);
  void Post(Task task);

  // The next item; where there is none, waits for it until `deadline` or a stop.
  std::optional<Item> Pop(const std::stop_token& stop, Clock::time_point deadline);
  // The same without waiting.
  std::optional<Item> TryPop();

  size_t num_messages() const;
  int64_t dropped() const;
  // Of the thread whose inbox it is; each item is one, and so is what the thread adds.
  WorkSteps& steps() { return steps_; }

 private:
  static size_t Footprint(const Item& item);
  std::optional<Item> PopLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void DropOldest() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const size_t max_bytes_;
  mutable Mutex mutex_;
  ConditionVariable pushed_;
  std::deque<Item> items_ ABSL_GUARDED_BY(mutex_);
  size_t num_messages_ ABSL_GUARDED_BY(mutex_) = 0;
  size_t bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  int64_t dropped_ ABSL_GUARDED_BY(mutex_) = 0;
  WorkSteps steps_;
};

}  // namespace splinemap
