#include "lib/fleet/nats_subscription.h"

#include <utility>

#include "lib/fleet/fleet_key.h"

namespace splinemap {
namespace {

// What waits for a handler in this process, before changes are dropped and counted.
constexpr int kMaxPendingMessages = 65'536;
constexpr int kMaxPendingBytes = 256 << 20;

}  // namespace

struct NatsSubscription::Receiver {
  explicit Receiver(Handler h) : handler(std::move(h)) {}
  const Handler handler;
  std::string subject;
  Mutex mutex;
  bool is_over ABSL_GUARDED_BY(mutex) = false;
};

NatsSubscription::NatsSubscription(Handler handler)
    : receiver_(std::make_shared<Receiver>(std::move(handler))) {}

NatsSubscription::~NatsSubscription() {
  if (!subscription_) return;
  natsSubscription_Unsubscribe(subscription_.get());
  MutexLock lock(receiver_->mutex);
  receiver_->is_over = true;
}

natsStatus NatsSubscription::Begin(natsConnection* connection, const std::string& subject,
                                   const std::string& queue) {
  receiver_->subject = subject;
  natsSubscription* made = nullptr;
  const auto handle = [](natsConnection*, natsSubscription*, natsMsg* message, void* closure) {
    const NatsHandle<natsMsg> owned(message);
    Receiver& receiver = **static_cast<std::shared_ptr<Receiver>*>(closure);
    if (!MatchesFilter(receiver.subject, natsMsg_GetSubject(message))) return;
    MutexLock lock(receiver.mutex);
    if (!receiver.is_over) receiver.handler(message);
  };
  // The library may call once more after it was told to end, and says when it does not any more.
  auto closure = std::make_unique<std::shared_ptr<Receiver>>(receiver_);
  const natsStatus status =
      queue.empty()
          ? natsConnection_Subscribe(&made, connection, subject.c_str(), handle, closure.get())
          : natsConnection_QueueSubscribe(&made, connection, subject.c_str(), queue.c_str(), handle,
                                          closure.get());
  if (status != NATS_OK) return status;
  subscription_.reset(made);
  natsSubscription_SetOnCompleteCB(
      made, [](void* over) { delete static_cast<std::shared_ptr<Receiver>*>(over); },
      closure.release());
  return natsSubscription_SetPendingLimits(made, kMaxPendingMessages, kMaxPendingBytes);
}

}  // namespace splinemap
