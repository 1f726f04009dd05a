#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "lcmtypes/splinemap/request_t.hpp"

namespace splinemap {

// The last so many ids that were added. Thread-compatible.
class RecentIds {
 public:
  explicit RecentIds(size_t max) : max_(max) {}

  // Makes it the newest.
  void Add(int64_t id);
  // Whether it was there.
  bool Remove(int64_t id);

 private:
  const size_t max_;
  uint64_t last_turn_ = 0;
  std::map<int64_t, uint64_t> turns_;  // by id
  std::map<uint64_t, int64_t> ids_;    // by turn: the oldest first
};

// Requests wait in a line for each client that has asked before, and one for all others: clients
// choose their ids, and LCM does not say who sends, so a flood of new ids counts as one client.
// Nothing for that one.
using RequestLine = std::optional<int64_t>;

struct QueuedRequest {
  request_t header;
  std::vector<uint8_t> bytes;
  RequestLine line = std::nullopt;
};

// Requests that wait, so many in each line and in all. Lines are served in turn: who asks much
// keeps himself waiting, nobody else. Thread-compatible.
class RequestQueue {
 public:
  static constexpr size_t kMaxOfLine = 64;
  static constexpr size_t kMax = 1024;
  static constexpr size_t kMaxClients = 4096;  // that are known, and that are seen once

  // kFull: it was not taken. kWaiting: it was sent again, and has not had its turn yet.
  enum class PushResult { kTaken, kWaiting, kFull };
  PushResult Push(const request_t& header, absl::Span<const uint8_t> bytes);

  bool empty() const { return turns_.empty(); }
  // Requires !empty().
  QueuedRequest Pop();

 private:
  using Waiting = std::deque<QueuedRequest>;

  RequestLine LineOf(int64_t client);
  void Add(QueuedRequest request);
  void MoveToOwnLine(int64_t client);

  RecentIds seen_{kMaxClients};
  RecentIds known_{kMaxClients};
  std::map<RequestLine, Waiting> lines_;  // none is empty
  std::deque<RequestLine> turns_;         // each of them once
  size_t size_ = 0;
};

}  // namespace splinemap
