#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>
#include <variant>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lib/replication/byte_budget.h"
#include "lib/replication/fifo_set.h"
#include "lib/replication/hash_tree.h"
#include "lib/replication/protocol.h"
#include "lib/replication/replication_message.h"
#include "lib/tiles/tile_codec.h"
#include "splinemap/map_view.h"

namespace splinemap {

struct PublisherOptions {
  double bytes_per_s = 1e6;  // of all that is sent but digests and headers of updates
  std::chrono::milliseconds push_interval{100};
  std::chrono::milliseconds digest_interval{1000};
  bool pushes = true;  // else what changed is only answered for
  // Of a layer whose owner keeps its scans, these are pushed, and tiles only while a follower asks
  // for them.
  bool sends_scans = true;
  // Who speaks; nothing: the owner, whose number is the nonce of the layer's session.
  std::optional<uint64_t> proxy;
};

// Publishes the tiles of one layer at one level of detail: says with a digest what it has
// published, and answers pulls. As it was mapped, it pushes changes, oldest first; coarser levels
// are published in silence. Where scans are sent, whatever they changed counts as published, and is
// pushed only while a follower asks for tiles. Thread-compatible.
class LayerPublisher {
 public:
  // What `layer` has already counts as published: followers that lack it will pull it.
  LayerPublisher(LayerRef ref, const LayerSnapshot& layer, const MapOptions& map_options,
                 const PublisherOptions& options);

  // The layer's newest state; what changed since the last one waits to be pushed.
  void SetLayer(const LayerSnapshot& layer, Clock::time_point now);

  // Since when there are changes that are not in a coarser level yet, or scans that were not sent.
  void SetBehind(std::optional<Clock::time_point> since) { behind_since_ = since; }

  // Requires a pull of this session and this level, or a call.
  void HandlePull(const layer_pull_t& pull, Clock::time_point now);

  // A follower asked for scans.
  void HearScanPull(Clock::time_point now) { last_pull_ = now; }

  bool HasChanges() const { return !waiting_.empty(); }
  bool HasDigested() const { return last_digest_.has_value(); }
  // Whether the present state was digested so often that followers on a lossy bus know it, and none
  // of them is asking for what it lacks.
  bool IsKnown(Clock::time_point now) const;
  bool HasPulls() const { return !pulled_tiles_.empty() || !pulled_nodes_.empty(); }
  // Whether the next tick has more to answer.
  bool CanAnswer() const { return HasPulls() && !waits_for_budget_; }

  // Adds what is to be sent now, as far as the budget goes.
  void Tick(Clock::time_point now, ByteBudget& budget, std::vector<ReplicationMessage>& messages,
            bool may_digest = true);
  // When the next push or digest is due.
  Clock::time_point NextTick() const;
  // The same, whatever the intervals: what waits, and a digest. For an owner that leaves: called
  // until it IsKnown(), it leaves nothing behind that only the owner had.
  void LastTick(Clock::time_point now, ByteBudget& budget,
                std::vector<ReplicationMessage>& messages);

 private:
  struct Change {
    TileKey key;
    uint64_t after_revision;  // a commit later than this one made it
    Clock::time_point since;
  };

  bool Pushes() const { return ref_.level_of_detail == LevelOfDetail{} && options_.pushes; }
  bool SendsScans() const { return Pushes() && options_.sends_scans; }
  bool PushesTiles(Clock::time_point now) const;
  void Answer(ByteBudget& budget, std::vector<ReplicationMessage>& messages);
  void Push(ByteBudget& budget, std::vector<ReplicationMessage>& messages);
  // Done with a change that left the tile as it is published.
  bool SkipUnchanged(TileKey key);
  // Publishes the tile as it is now, as a difference to the last digest where that is allowed and
  // shorter.
  TileUpdate Publish(TileKey key, bool as_difference);
  void Digest(std::vector<ReplicationMessage>& messages, Clock::time_point now);
  layer_digest_t MakeDigest(Clock::time_point now);

  const LayerRef ref_;
  const int64_t speaker_;
  const MapOptions map_options_;
  const PublisherOptions options_;

  LayerSnapshot layer_;
  uint64_t state_;  // counts on with everything that is published
  std::optional<Clock::time_point> behind_since_;
  TileTreeEditor published_;
  HashTree index_;                         // of published_
  TileTree at_digest_;                     // published_ when the last digest was sent
  absl::flat_hash_set<TileKey> answered_;  // since then

  bool IsWaiting(const Change& change) const;

  std::deque<Change> changes_;                      // by age; some are done already
  absl::flat_hash_map<TileKey, uint64_t> waiting_;  // their after_revision
  FifoSet<TileKey> pulled_tiles_;
  FifoSet<NodeKey> pulled_nodes_;
  bool waits_for_budget_ = false;                  // as of the last tick
  std::optional<Clock::time_point> tiles_wanted_;  // when a follower asked for pushes last
  std::optional<Clock::time_point> last_push_;
  std::optional<Clock::time_point> last_digest_;
  int digests_of_state_ = 0;
  std::optional<Clock::time_point> last_pull_;
};

}  // namespace splinemap
