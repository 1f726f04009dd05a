#pragma once

#include <optional>

#include "lib/replication/protocol.h"

namespace splinemap {

// Decides which session of its layer an owner has to start when others speak of another session. Of
// two owners of one layer the one in the lesser session gives way. One message alone changes
// nothing: what is there is repeated. Thread-compatible.
class SessionGuard {
 public:
  // Sessions of other layers and the owner's own are ignored.
  //
  // An owner's digest: another owner is on the bus, or a log of one.
  void HandleDigest(const LayerRef& heard, const LayerRef& own, Clock::time_point now);
  // A follower or a proxy knows a session: if it is a later one and its owner is not there, this
  // owner's file is an older copy.
  void HandleKnown(const LayerRef& heard, const LayerRef& own, Clock::time_point now);

  struct NextSession {
    LayerRef ref;
    bool is_other_layer = false;  // another owner has the old one
  };
  // The session to start now; nothing where all is well. Call it some times a second. `random` are
  // fresh random bits. The nonce stays: it is of the owner's process.
  std::optional<NextSession> Next(const LayerRef& own, Clock::time_point now, uint64_t random);

 private:
  // The greatest session that was heard of, of the layer that was one's own then.
  struct Heard {
    LayerRef ref;
    Clock::time_point since;
    Clock::time_point last;
  };
  static void Remember(std::optional<Heard>& heard, const LayerRef& ref, Clock::time_point now);

  std::optional<Heard> other_owner_;
  std::optional<Heard> known_;
};

}  // namespace splinemap
