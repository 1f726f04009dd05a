#include "services/splinemapd/mailbox.h"

#include <algorithm>
#include <utility>

namespace splinemap {
namespace {

bool IsMessage(const Mailbox::Item& item) { return std::holds_alternative<MailboxMessage>(item); }

}  // namespace

size_t Mailbox::Footprint(const Item& item) {
  constexpr size_t kOverhead = 128;  // of the containers, about
  const auto* message = std::get_if<MailboxMessage>(&item);
  return message == nullptr ? 0 : message->channel.size() + message->bytes.size() + kOverhead;
}

void Mailbox::Push(const std::string& channel, absl::Span<const uint8_t> message, Utime received,
                   bool wakes) {
  Item item = MailboxMessage{channel, {message.begin(), message.end()}, received};
  {
    MutexLock lock(mutex_);
    if (Footprint(item) > max_bytes_) {
      ++dropped_;
      return;
    }
    bytes_ += Footprint(item);
    ++num_messages_;
    items_.push_back(std::move(item));
    while (bytes_ > max_bytes_) DropOldest();
  }
  if (wakes) pushed_.notify_one();
}

void Mailbox::DropOldest() {
  const auto oldest = std::find_if(items_.begin(), items_.end(), IsMessage);
  bytes_ -= Footprint(*oldest);
  --num_messages_;
  ++dropped_;
  items_.erase(oldest);
}

void Mailbox::Post(Task task) {
  {
    MutexLock lock(mutex_);
    items_.emplace_back(std::move(task));
  }
  pushed_.notify_one();
}

std::optional<Mailbox::Item> Mailbox::PopLocked() {
  if (items_.empty()) return std::nullopt;
  Item item = std::move(items_.front());
  items_.pop_front();
  bytes_ -= Footprint(item);
  num_messages_ -= IsMessage(item) ? 1 : 0;
  return item;
}

std::optional<Mailbox::Item> Mailbox::Pop(const std::stop_token& stop, Clock::time_point deadline) {
  const WorkSteps::Waiting waiting(steps_);
  std::unique_lock lock(mutex_);
  pushed_.wait_until(lock, stop, deadline, [this] { return !items_.empty(); });
  return PopLocked();
}

std::optional<Mailbox::Item> Mailbox::TryPop() {
  steps_.Add();
  MutexLock lock(mutex_);
  return PopLocked();
}

size_t Mailbox::num_messages() const {
  MutexLock lock(mutex_);
  return num_messages_;
}

int64_t Mailbox::dropped() const {
  MutexLock lock(mutex_);
  return dropped_;
}

}  // namespace splinemap
