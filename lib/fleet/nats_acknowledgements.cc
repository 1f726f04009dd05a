#include "lib/fleet/nats_acknowledgements.h"

#include <algorithm>
#include <utility>

#include "lib/base/clock.h"
#include "lib/fleet/nats_connection.h"

namespace splinemap {

void NatsAcknowledgements::Await(natsMsg* message) {
  MutexLock lock(mutex_);
  awaited_.insert(message);
}

void NatsAcknowledgements::GiveUp(natsMsg* message) {
  MutexLock lock(mutex_);
  awaited_.erase(message);
}

void NatsAcknowledgements::Handle(natsMsg* message, const jsPubAck* ack, const jsPubAckErr* error) {
  MutexLock lock(mutex_);
  if (awaited_.erase(message) == 0) return;
  if (ack != nullptr) outcome_.revision = std::max(outcome_.revision, ack->Sequence);
  if (error != nullptr && outcome_.status == NATS_OK) {
    outcome_.status = error->Err;
    outcome_.code = error->ErrCode;
    outcome_.text = error->ErrText != nullptr ? error->ErrText : "";
  }
  changed_.notify_all();
}

void NatsAcknowledgements::Refuse() {
  MutexLock lock(mutex_);
  if (awaited_.empty()) return;
  awaited_.clear();
  outcome_.status = NATS_NOT_PERMITTED;
  changed_.notify_all();
}

NatsAcknowledgements::Outcome NatsAcknowledgements::Wait() {
  MutexLock lock(mutex_);
  while (!awaited_.empty()) {
    const size_t before = awaited_.size();
    const auto end = Clock::now() + NatsConnection::kTimeout;
    while (awaited_.size() == before && Clock::now() < end) changed_.wait_until(mutex_, end);
    if (awaited_.size() == before) {
      awaited_.clear();
      if (outcome_.status == NATS_OK) outcome_.status = NATS_TIMEOUT;
    }
  }
  return std::exchange(outcome_, Outcome());
}

}  // namespace splinemap
