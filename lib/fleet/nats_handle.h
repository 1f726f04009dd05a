#pragma once

#include <nats/nats.h>

#include <memory>

namespace splinemap {

// Objects of the NATS library, which are freed as each is to be.
struct NatsFree {
  void operator()(natsOptions* options) const { natsOptions_Destroy(options); }
  void operator()(natsConnection* connection) const { natsConnection_Destroy(connection); }
  void operator()(natsMsg* message) const { natsMsg_Destroy(message); }
  void operator()(natsSubscription* subscription) const { natsSubscription_Destroy(subscription); }
  void operator()(jsCtx* context) const { jsCtx_Destroy(context); }
};
template <typename T>
using NatsHandle = std::unique_ptr<T, NatsFree>;

}  // namespace splinemap
