#include "services/splinemapd/request_queue.h"

#include <algorithm>
#include <utility>

#include "lcmtypes/splinemap/request_t.hpp"

namespace splinemap {

void RecentIds::Add(int64_t id) {
  Remove(id);
  turns_[id] = ++last_turn_;
  ids_[last_turn_] = id;
  if (ids_.size() > max_) Remove(ids_.begin()->second);
}

bool RecentIds::Remove(int64_t id) {
  const auto turn = turns_.find(id);
  if (turn == turns_.end()) return false;
  ids_.erase(turn->second);
  turns_.erase(turn);
  return true;
}

RequestLine RequestQueue::LineOf(int64_t client) {
  const bool is_known = known_.Remove(client);
  if (!is_known && !seen_.Remove(client)) {
    seen_.Add(client);
    return std::nullopt;
  }
  known_.Add(client);
  if (!is_known) MoveToOwnLine(client);
  return client;
}

void RequestQueue::MoveToOwnLine(int64_t client) {
  const auto line = lines_.find(std::nullopt);
  if (line == lines_.end()) return;
  Waiting& others = line->second;
  const auto first = std::stable_partition(
      others.begin(), others.end(), [&](const auto& r) { return r.header.client != client; });
  Waiting own(std::make_move_iterator(first), std::make_move_iterator(others.end()));
  others.erase(first, others.end());
  if (others.empty()) {
    lines_.erase(line);
    std::erase(turns_, std::nullopt);
  }
  for (QueuedRequest& request : own) {
    request.line = client;
    Add(std::move(request));
  }
}

void RequestQueue::Add(QueuedRequest request) {
  Waiting& waiting = lines_[request.line];
  if (waiting.empty()) turns_.push_back(request.line);
  waiting.push_back(std::move(request));
}

RequestQueue::PushResult RequestQueue::Push(const request_t& header,
                                            absl::Span<const uint8_t> bytes) {
  const RequestLine line = LineOf(header.client);
  if (const auto found = lines_.find(line); found != lines_.end()) {
    const Waiting& waiting = found->second;
    const bool is_waiting = std::any_of(waiting.begin(), waiting.end(), [&](const auto& request) {
      return request.header.client == header.client && request.header.id == header.id;
    });
    if (is_waiting) return PushResult::kWaiting;
    if (waiting.size() >= kMaxOfLine) return PushResult::kFull;
  }
  if (size_ >= kMax) return PushResult::kFull;
  Add({header, {bytes.begin(), bytes.end()}, line});
  ++size_;
  return PushResult::kTaken;
}

QueuedRequest RequestQueue::Pop() {
  const auto line = lines_.find(turns_.front());
  turns_.pop_front();
  QueuedRequest request = std::move(line->second.front());
  line->second.pop_front();
  --size_;
  if (line->second.empty()) {
    lines_.erase(line);
  } else {
    turns_.push_back(request.line);
  }
  return request;
}

}  // namespace splinemap
