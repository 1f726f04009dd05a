#pragma once

#include <nats/nats.h>

#include <cstdint>
#include <set>
#include <string>

#include "lib/base/mutex.h"

namespace splinemap {

// Messages that are being written, and what servers say of them. Thread-safe.
class NatsAcknowledgements {
 public:
  void Await(natsMsg* message);
  // Of one that is not sent after all.
  void GiveUp(natsMsg* message);
  // What a server says of one. Those that were given up are ignored.
  void Handle(natsMsg* message, const jsPubAck* ack, const jsPubAckErr* error);
  // Servers do not allow one of them, and do not say which.
  void Refuse();

  struct Outcome {
    natsStatus status = NATS_OK;  // the first that is not; NATS_TIMEOUT where nothing came in time
    jsErrCode code{};
    std::string text;
    uint64_t revision = 0;  // the greatest
  };
  // Waits for all, and forgets them.
  Outcome Wait();

 private:
  Mutex mutex_;
  ConditionVariable changed_;
  std::set<natsMsg*> awaited_ ABSL_GUARDED_BY(mutex_);
  Outcome outcome_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace splinemap
