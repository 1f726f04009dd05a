#pragma once

#include <optional>
#include <variant>
#include <vector>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lib/replication/layer_follower.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/replication/random_backoff.h"

namespace splinemap {

// Speaks for a layer whose owner is silent, from the copy of a follower: digests it and answers
// pulls, so that late joiners find it and all copies become equal. Of several, one speaks; another
// one takes over when it stops, or when it lacks what that one has. Without clocks, threads or
// sockets of its own. Thread-compatible.
class ProxyPublisher {
 public:
  // Begins where nobody speaks for `delay` after the owner fell silent. `speaker` tells one proxy
  // from another. `copy` is of all of a layer as it was mapped, and outlives this.
  ProxyPublisher(LayerFollower& copy, Clock::duration delay, uint64_t speaker,
                 const MapOptions& map_options, const PublisherOptions& options);

  // What `copy` has taken already.
  void HandleDigest(const layer_digest_t& digest, Clock::time_point now);
  void HandlePull(const layer_pull_t& pull, Clock::time_point now);
  void HandleScanPull(const scan_pull_t& pull, Clock::time_point now);

  // What is to be sent now. Call it some times a second. Where it may not begin, it speaks only to
  // others who do and lack something.
  std::vector<ReplicationMessage> Tick(Clock::time_point now, ByteBudget& budget,
                                       bool may_begin = true);
  bool HasPulls() const { return publisher_ && publisher_->HasPulls(); }
  // When that will have something to do, if nothing comes before.
  Clock::time_point NextTick(Clock::time_point now) const;

 private:
  bool MaySpeak(Clock::time_point now) const;
  bool OtherIsHeard(Clock::time_point now) const;
  bool OtherLacksSomething(Clock::time_point now) const;
  void BeginBy(Clock::time_point latest);
  void LeaveItToOthers(Clock::time_point now);

  LayerFollower& copy_;
  const Clock::duration delay_;
  const uint64_t speaker_;
  const MapOptions map_options_;
  PublisherOptions options_;
  RandomBackoff random_;
  std::optional<PyramidPublisher> publisher_;  // while it speaks
  SessionId session_;                          // of what it speaks for
  uint64_t lineage_ = 0;                       // of its tiles
  std::optional<Clock::time_point> due_;       // when it is to begin
  std::optional<layer_digest_t> other_;        // the last that was heard while the owner was silent
  Clock::time_point other_heard_;
};

}  // namespace splinemap
