#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "lib/wire/decode.h"

namespace splinemap {

struct QueuedRequest {
  request_t head;
  std::vector<uint8_t> bytes;
};

// Requests that wait, so many of each client and in all. Clients are served in turn: who asks much
// keeps himself waiting, nobody else. Thread-compatible.
class RequestQueue {
 public:
  static constexpr size_t kMaxOfClient = 64;
  static constexpr size_t kMax = 1024;

  // kFull: it was not taken. kWaiting: it was sent again, and has not had its turn yet.
  enum class Pushed { kTaken, kWaiting, kFull };
  Pushed Push(const request_t& head, absl::Span<const uint8_t> bytes);

  bool empty() const { return turns_.empty(); }
  // Requires !empty().
  QueuedRequest Pop();

 private:
  std::map<int64_t, std::deque<QueuedRequest>> clients_;  // that have requests
  std::deque<int64_t> turns_;                             // each of them once
  size_t size_ = 0;
};

}  // namespace splinemap
