#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lib/replication/byte_budget.h"
#include "lib/replication/fifo_set.h"
#include "lib/replication/protocol.h"
#include "lib/replication/recent_scans.h"
#include "lib/replication/replication_message.h"

namespace splinemap {

// Publishes the scans of a layer: its owner each as soon as it is mapped, and proxies, too, those
// that are pulled. Thread-compatible.
class ScanPublisher {
 public:
  // `scans` outlive it. Where it `pushes`, it is the owner's.
  ScanPublisher(LayerRef ref, int64_t speaker, uint64_t revision, RecentScans& scans, bool pushes);

  // The layer has this revision, and `scans` those that led to it, as far as they can be sent. They
  // wait to be pushed.
  void SetRevision(uint64_t revision, Clock::time_point now);

  // Requires a pull of this session.
  void HandlePull(const scan_pull_t& pull);

  uint64_t revision() const { return revision_; }
  bool HasChanges() const { return pushed_ < revision_; }
  bool HasPulls() const { return !pulled_.empty() || lacks_pulled_; }
  // Since when the oldest scan waits that was not pushed.
  std::optional<Clock::time_point> waiting_since() const {
    return HasChanges() ? std::optional(waiting_.front().since) : std::nullopt;
  }

  // Adds what is to be sent now, as far as the budget goes. What waits for longer than a second is
  // given up, and cannot be had any more: followers ask for tiles.
  void Tick(Clock::time_point now, ByteBudget& budget, std::vector<ReplicationMessage>& messages);
  // When that will have something to do.
  Clock::time_point NextTick() const;

 private:
  class Batch;

  void Answer(Batch& batch, ByteBudget& budget);
  void Push(Batch& batch, ByteBudget& budget);
  void GiveUpWhatIsOld(Clock::time_point now);
  uint64_t Oldest() const;

  const LayerRef ref_;
  const int64_t speaker_;
  RecentScans& scans_;
  const bool pushes_;
  uint64_t revision_;  // of the layer
  uint64_t pushed_;    // up to this one
  struct Waiting {
    uint64_t revision;
    Clock::time_point since;
  };
  std::deque<Waiting> waiting_;  // the revisions beyond pushed_, some together
  Clock::time_point next_tick_;  // for what the last one has left
  FifoSet<uint64_t> pulled_;
  bool lacks_pulled_ = false;  // somebody asked for what cannot be sent any more
};

}  // namespace splinemap
