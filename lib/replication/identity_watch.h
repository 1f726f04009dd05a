#pragma once

#include <optional>

#include "lib/replication/protocol.h"

namespace splinemap {

// What an owner hears of other lives of its own layer, and which life it has to begin then. Of two
// owners of one layer the one in the lesser life gives way. One message alone changes nothing: who
// is there says so again and again. Thread-compatible.
class IdentityWatch {
 public:
  // Lives of other layers and the owner's own are ignored.
  //
  // A digest: another owner is on the bus, or a log of one.
  void TakeDigest(const LayerLife& heard, const LayerLife& own, Clock::time_point now);
  // A follower asks for a life: if it is a later one and its owner is not there, this one's file is
  // an older copy.
  void TakePull(const LayerLife& heard, const LayerLife& own, Clock::time_point now);

  struct NextLife {
    LayerLife life;
    bool is_other_layer = false;  // another owner has the old one
  };
  // The life to begin now; nothing where all is well. Ask some times a second. `random` are fresh
  // random bits.
  std::optional<NextLife> Next(const LayerLife& own, Clock::time_point now, uint64_t random);

 private:
  // The greatest life that was heard of, of the layer that was one's own then.
  struct Heard {
    LayerLife life;
    Clock::time_point since;
    Clock::time_point last;
  };
  static void Remember(std::optional<Heard>& heard, const LayerLife& life, Clock::time_point now);

  std::optional<Heard> other_owner_;
  std::optional<Heard> asked_for_;
};

}  // namespace splinemap
