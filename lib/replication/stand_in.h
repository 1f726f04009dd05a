#pragma once

#include <optional>
#include <variant>
#include <vector>

#include "lcmtypes/splinemap/stand_in_digest_t.hpp"
#include "lib/replication/layer_follower.h"
#include "lib/replication/levels_publisher.h"
#include "lib/replication/random_pause.h"

namespace splinemap {

// Speaks for a layer whose owner is silent, from the copy of a follower: digests it and answers
// pulls, so that late joiners find it and all copies become equal. Of several, one speaks; another
// one takes over when it stops, or when it lacks what that one has. Without clocks, threads or
// sockets of its own. Thread-compatible.
class StandIn {
 public:
  using Message = std::variant<layer_updates_t, layer_listing_t, stand_in_digest_t>;

  // Begins where nobody speaks for `patience` after the owner fell silent. `nonce` tells one that
  // stands in from another. `copy` is of all of a layer as it was mapped, and outlives this.
  StandIn(LayerFollower& copy, Clock::duration patience, uint64_t nonce,
          const MapOptions& map_options, const PublisherOptions& options);

  // What `copy` has taken already.
  void TakeDigest(const stand_in_digest_t& other, Clock::time_point now);
  void TakePull(const layer_pull_t& pull, Clock::time_point now);

  // What is to be sent now. Call it some times a second. Where it may not begin, it speaks only to
  // others who do and lack something.
  std::vector<Message> Tick(Clock::time_point now, bool may_begin = true);

 private:
  bool MaySpeak(Clock::time_point now) const;
  bool OtherIsHeard(Clock::time_point now) const;
  bool OtherLacksSomething(Clock::time_point now) const;
  void BeginBy(Clock::time_point latest);
  void LeaveItToOthers(Clock::time_point now);

  LayerFollower& copy_;
  const Clock::duration patience_;
  const uint64_t nonce_;
  const MapOptions map_options_;
  PublisherOptions options_;
  RandomPause random_;
  std::optional<LevelsPublisher> publisher_;  // while it speaks
  LayerEpoch epoch_;                          // of what it speaks for
  uint64_t line_ = 0;                         // of its tiles
  std::optional<Clock::time_point> due_;      // when it is to begin
  std::optional<stand_in_digest_t> other_;    // the last that was heard while the owner was silent
  Clock::time_point other_heard_;
};

}  // namespace splinemap
