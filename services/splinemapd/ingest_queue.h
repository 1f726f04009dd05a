#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lib/base/mutex.h"

namespace splinemap {

struct IngestedMessage {
  std::string channel;
  std::vector<uint8_t> bytes;
};

// Messages between the thread that receives and the one that maps. When more than `max_bytes` wait,
// the oldest are dropped and counted. Thread-safe.
class IngestQueue {
 public:
  explicit IngestQueue(size_t max_bytes) : max_bytes_(max_bytes) {}

  void Push(const std::string& channel, absl::Span<const uint8_t> message);

  // Waits for the next message; nothing after `timeout` without one.
  std::optional<IngestedMessage> Pop(std::chrono::milliseconds timeout);

  size_t size() const;
  int64_t dropped() const;

 private:
  static size_t Footprint(const IngestedMessage& message);

  const size_t max_bytes_;
  mutable Mutex mutex_;
  ConditionVariable pushed_;
  std::deque<IngestedMessage> messages_ ABSL_GUARDED_BY(mutex_);
  size_t bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  int64_t dropped_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace splinemap
