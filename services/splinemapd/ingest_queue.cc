#include "services/splinemapd/ingest_queue.h"

#include <utility>

namespace splinemap {

size_t IngestQueue::Footprint(const IngestedMessage& message) {
  constexpr size_t kOverhead = 128;  // of the containers, about
  return message.channel.size() + message.bytes.size() + kOverhead;
}

void IngestQueue::Push(const std::string& channel, absl::Span<const uint8_t> message) {
  IngestedMessage ingested{channel, {message.begin(), message.end()}};
  {
    MutexLock lock(mutex_);
    if (Footprint(ingested) > max_bytes_) {
      ++dropped_;
      return;
    }
    bytes_ += Footprint(ingested);
    messages_.push_back(std::move(ingested));
    while (bytes_ > max_bytes_) {
      bytes_ -= Footprint(messages_.front());
      messages_.pop_front();
      ++dropped_;
    }
  }
  pushed_.notify_one();
}

std::optional<IngestedMessage> IngestQueue::Pop(std::chrono::milliseconds timeout) {
  std::unique_lock lock(mutex_);
  if (!pushed_.wait_for(lock, timeout, [this] { return !messages_.empty(); })) return std::nullopt;
  IngestedMessage message = std::move(messages_.front());
  messages_.pop_front();
  bytes_ -= Footprint(message);
  return message;
}

size_t IngestQueue::size() const {
  MutexLock lock(mutex_);
  return messages_.size();
}

int64_t IngestQueue::dropped() const {
  MutexLock lock(mutex_);
  return dropped_;
}

}  // namespace splinemap
