#include "services/splinemapd/request_queue.h"

#include <algorithm>
#include <utility>

namespace splinemap {

RequestQueue::Pushed RequestQueue::Push(const request_t& head, absl::Span<const uint8_t> bytes) {
  const auto client = clients_.find(head.client);
  if (client != clients_.end()) {
    const std::deque<QueuedRequest>& waiting = client->second;
    const bool is_waiting = std::any_of(waiting.begin(), waiting.end(), [&](const auto& request) {
      return request.head.id == head.id;
    });
    if (is_waiting) return Pushed::kWaiting;
    if (waiting.size() >= kMaxOfClient) return Pushed::kFull;
  }
  if (size_ >= kMax) return Pushed::kFull;
  if (client == clients_.end()) turns_.push_back(head.client);
  clients_[head.client].push_back({head, {bytes.begin(), bytes.end()}});
  ++size_;
  return Pushed::kTaken;
}

QueuedRequest RequestQueue::Pop() {
  const auto client = clients_.find(turns_.front());
  turns_.pop_front();
  QueuedRequest request = std::move(client->second.front());
  client->second.pop_front();
  --size_;
  if (client->second.empty()) {
    clients_.erase(client);
  } else {
    turns_.push_back(request.head.client);
  }
  return request;
}

}  // namespace splinemap
