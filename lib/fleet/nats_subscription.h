#pragma once

#include <nats/nats.h>

#include <functional>
#include <memory>
#include <string>

#include "lib/base/mutex.h"
#include "lib/fleet/fleet_store.h"
#include "lib/fleet/nats_handle.h"

namespace splinemap {

// A subscription whose handler runs in a thread of the library, and does not after the destructor.
// It hears what was said to its subject alone: a reader of the bucket may have entries delivered to
// any, but they keep the subject that they were written to.
class NatsSubscription : public FleetSubscription {
 public:
  using Handler = std::function<void(natsMsg* message)>;
  inline static const std::string kInboxes = "_INBOX.";  // what replies go to

  explicit NatsSubscription(Handler handler);
  ~NatsSubscription() override;

  // Of each message one of all members of `queue` is told; empty: all are.
  natsStatus Begin(natsConnection* connection, const std::string& subject,
                   const std::string& queue);

 private:
  struct Receiver;

  const std::shared_ptr<Receiver> receiver_;
  NatsHandle<natsSubscription> subscription_;
};

}  // namespace splinemap
