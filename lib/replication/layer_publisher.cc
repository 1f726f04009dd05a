#include "lib/replication/layer_publisher.h"

#include <algorithm>
#include <utility>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/node_listing_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/base/host_clock.h"

namespace splinemap {
namespace {

constexpr size_t kMaxPulled = 100'000;  // more waiting pulls are for the next round
// Tiles in one tick, so that followers take up some while others are packed.
constexpr int kMaxAnswersAtOnce = 256;
// Digests that are asked for are this far apart.
constexpr std::chrono::milliseconds kLeastDigestInterval(100);
// Where half of them get lost, one in 64 followers misses all of these.
constexpr int kDigestsOfKnownState = 6;
// Followers ask again three times in it, so that one who lacks something is heard.
constexpr std::chrono::milliseconds kPullPause(1200);
// Where scans are sent, tiles are pushed for so long after a follower asked for that.
constexpr std::chrono::seconds kTileLease(30);

tile_update_t ToMessage(const TileUpdate& update) {
  tile_update_t message;
  message.tx = update.key.tx;
  message.ty = update.key.ty;
  message.revision = static_cast<int64_t>(update.revision);
  message.base_checksum = static_cast<int64_t>(update.base_checksum);
  message.checksum = static_cast<int64_t>(update.checksum);
  message.content.assign(update.content.begin(), update.content.end());
  message.num_bytes = static_cast<int32_t>(message.content.size());
  return message;
}

// Fills messages up to kMaxMessageBytes.
class UpdateBatch {
 public:
  UpdateBatch(int64_t speaker, const LayerRef& ref, std::vector<ReplicationMessage>& messages)
      : messages_(messages) {
    batch_.speaker = speaker;
    batch_.layer = ToMessage(ref);
    batch_.num_tiles = 0;
    empty_bytes_ = batch_.getEncodedSize();
    bytes_ = empty_bytes_;
  }
  ~UpdateBatch() { Send(); }

  // Returns what it adds to the bytes sent.
  size_t Add(const TileUpdate& update) {
    tile_update_t message = ToMessage(update);
    const size_t bytes = message._getEncodedSizeNoHash();
    if (bytes_ + bytes > kMaxMessageBytes) Send();
    batch_.tiles.push_back(std::move(message));
    bytes_ += bytes;
    return bytes;
  }

 private:
  void Send() {
    if (batch_.tiles.empty()) return;
    batch_.num_tiles = static_cast<int32_t>(batch_.tiles.size());
    messages_.emplace_back(batch_);
    batch_.tiles.clear();
    bytes_ = empty_bytes_;
  }

  std::vector<ReplicationMessage>& messages_;
  layer_updates_t batch_;
  size_t empty_bytes_;
  size_t bytes_;
};

}  // namespace

LayerPublisher::LayerPublisher(LayerRef ref, const LayerSnapshot& layer,
                               const MapOptions& map_options, const PublisherOptions& options)
    : ref_(std::move(ref)),
      speaker_(static_cast<int64_t>(options.proxy.value_or(ref_.session.nonce))),
      map_options_(map_options),
      options_(options),
      layer_(layer),
      state_(layer.revision),
      published_(layer.tiles) {
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    index_.Set(key, entry.tile->Checksum(key));
  });
}

void LayerPublisher::SetLayer(const LayerSnapshot& layer, Clock::time_point now) {
  const uint64_t after_revision = layer_.revision;
  const bool is_published = !Pushes() || SendsScans();
  const bool is_pushed = PushesTiles(now);
  layer.tiles.ForEachChanged(layer_.tiles.version(),
                             [&](TileKey key, const TileTree::Entry& entry) {
                               if (is_published) {
                                 published_.Put(key, entry.tile, entry.revision);
                                 index_.Set(key, entry.tile->Checksum(key));
                               }
                               if (is_pushed && waiting_.try_emplace(key, after_revision).second)
                                 changes_.push_back({key, after_revision, now});
                             });
  layer_ = layer;
  if (!is_published) return;
  if (layer.revision != after_revision) digests_of_state_ = 0;
  state_ = layer.revision;  // levels that were given up and made again count on
}

bool LayerPublisher::PushesTiles(Clock::time_point now) const {
  if (!SendsScans()) return Pushes();
  return tiles_wanted_ && now - *tiles_wanted_ <= kTileLease;
}

void LayerPublisher::HandlePull(const layer_pull_t& pull, Clock::time_point now) {
  if (IsCall(pull)) {
    if (last_digest_ && now - *last_digest_ >= kLeastDigestInterval) last_digest_.reset();
    return;
  }
  last_pull_ = now;
  if (pull.num_nodes == 0) tiles_wanted_ = now;
  for (int n = 0; n < pull.num_nodes; ++n) {
    if (pulled_tiles_.size() + pulled_nodes_.size() >= kMaxPulled) return;
    const NodeKey node{pull.levels[n], pull.xs[n], pull.ys[n]};
    if (node.level == 0) {
      const TileKey key{node.x, node.y};
      if (published_.tree().Find(key) != nullptr) pulled_tiles_.Push(key);
    } else if (node.IsValid()) {
      pulled_nodes_.Push(node);
    }
  }
}

void LayerPublisher::Tick(Clock::time_point now, ByteBudget& budget,
                          std::vector<ReplicationMessage>& messages, bool may_digest) {
  Answer(budget, messages);
  // Before the pushes, since followers know a session by its digest first. But what counts as
  // published when a digest says so has to be pushed before it.
  if (may_digest && (!last_digest_ || now >= *last_digest_ + options_.digest_interval)) {
    if (last_digest_ && SendsScans()) Push(budget, messages);
    Digest(messages, now);
  }
  // The first change after a pause goes at once.
  if (HasChanges() && (!last_push_ || now >= *last_push_ + options_.push_interval)) {
    last_push_ = now;
    Push(budget, messages);
  }
}

Clock::time_point LayerPublisher::NextTick() const {
  if (!last_digest_) return {};
  const Clock::time_point digest = *last_digest_ + options_.digest_interval;
  if (!HasChanges()) return digest;
  return last_push_ ? std::min(digest, *last_push_ + options_.push_interval) : Clock::time_point();
}

bool LayerPublisher::IsKnown(Clock::time_point now) const {
  return !HasChanges() && !HasPulls() && digests_of_state_ >= kDigestsOfKnownState &&
         (!last_pull_ || now - *last_pull_ >= kPullPause);
}

void LayerPublisher::LastTick(Clock::time_point now, ByteBudget& budget,
                              std::vector<ReplicationMessage>& messages) {
  last_push_.reset();
  Tick(now, budget, messages);
  while (CanAnswer()) Answer(budget, messages);
  Digest(messages, now);
}

void LayerPublisher::Digest(std::vector<ReplicationMessage>& messages, Clock::time_point now) {
  last_digest_ = now;
  ++digests_of_state_;
  messages.emplace_back(MakeDigest(now));
  at_digest_ = published_.Freeze();
  answered_.clear();
}

// Listings first: they are short, and followers ask on by them.
void LayerPublisher::Answer(ByteBudget& budget, std::vector<ReplicationMessage>& messages) {
  layer_listing_t listing;
  listing.speaker = speaker_;
  listing.layer = splinemap::ToMessage(ref_);
  listing.state = static_cast<int64_t>(state_);
  listing.num_nodes = 0;
  const auto send = [&] {
    if (listing.nodes.empty()) return;
    listing.num_nodes = static_cast<int32_t>(listing.nodes.size());
    budget.SpendOnAnswers(listing.getEncodedSize());
    messages.emplace_back(listing);
    listing.nodes.clear();
    listing.num_nodes = 0;
  };
  size_t bytes = listing.getEncodedSize();
  while (!pulled_nodes_.empty() && budget.MayAnswer()) {
    const NodeKey node = pulled_nodes_.Pop();
    node_listing_t of_node;
    of_node.level = node.level;
    of_node.x = node.x;
    of_node.y = node.y;
    for (const HashTree::Child& child : index_.ChildrenOf(node)) {
      const NodeKey key = node.Child(child.k);
      of_node.children.push_back(static_cast<uint8_t>(child.k));
      of_node.hashes.push_back(static_cast<int64_t>(child.hash));
      of_node.revisions.push_back(
          key.level > 0 ? 0 : static_cast<int64_t>(published_.tree().RevisionOf({key.x, key.y})));
    }
    of_node.num_children = static_cast<int32_t>(of_node.children.size());
    const size_t node_bytes = of_node._getEncodedSizeNoHash();
    if (bytes + node_bytes > kMaxMessageBytes) {
      send();
      bytes = listing.getEncodedSize();
    }
    bytes += node_bytes;
    listing.nodes.push_back(std::move(of_node));
  }
  send();

  UpdateBatch batch(speaker_, ref_, messages);
  for (int n = 0; n < kMaxAnswersAtOnce && !pulled_tiles_.empty() && budget.MayAnswer(); ++n) {
    const TileKey key = pulled_tiles_.Pop();
    // Who needed this one does not have what differences are made to, until the next digest.
    answered_.insert(key);
    budget.SpendOnAnswers(batch.Add(Publish(key, false)));
  }
  waits_for_budget_ = HasPulls() && !budget.MayAnswer();
}

void LayerPublisher::Push(ByteBudget& budget, std::vector<ReplicationMessage>& messages) {
  UpdateBatch batch(speaker_, ref_, messages);
  while (!changes_.empty() && budget.MayPush()) {
    const Change change = changes_.front();
    const TileKey key = change.key;
    changes_.pop_front();
    if (!IsWaiting(change) || (!SendsScans() && SkipUnchanged(key))) continue;
    budget.SpendOnPushes(batch.Add(Publish(key, !answered_.contains(key))));
  }
}

bool LayerPublisher::IsWaiting(const Change& change) const {
  const auto found = waiting_.find(change.key);
  return found != waiting_.end() && found->second == change.after_revision;
}

// Many a scan leaves control points at their limits as they were.
bool LayerPublisher::SkipUnchanged(TileKey key) {
  const StoredTile* published = published_.tree().Find(key);
  if (published == nullptr || !HaveEqualContent(*published, *layer_.tiles.Find(key))) return false;
  waiting_.erase(key);
  return true;
}

TileUpdate LayerPublisher::Publish(TileKey key, bool as_difference) {
  waiting_.erase(key);
  const uint64_t revision = layer_.tiles.RevisionOf(key);
  std::shared_ptr<const StoredTile> tile = layer_.tiles.Share(key);
  const std::shared_ptr<const Tile> content = tile->Get();
  TileUpdate update = MakeTileUpdate(key, *content, revision);
  if (const auto base = FindTile(at_digest_, key); as_difference && base != nullptr) {
    TileUpdate difference = MakeTileDifference(key, *content, revision, *base);
    if (difference.content.size() < update.content.size()) update = std::move(difference);
  }
  if (published_.tree().Find(key) != tile.get()) {
    ++state_;
    digests_of_state_ = 0;
  }
  published_.Put(key, std::move(tile), revision);
  index_.Set(key, update.checksum);
  return update;
}

layer_digest_t LayerPublisher::MakeDigest(Clock::time_point now) {
  while (!changes_.empty() && !IsWaiting(changes_.front())) changes_.pop_front();
  const bool is_published = SendsScans() || changes_.empty();
  layer_digest_t digest;
  digest.speaker = speaker_;
  digest.layer = splinemap::ToMessage(ref_);
  digest.protocol_version = kProtocolVersion;
  digest.utime = HostUtime();
  digest.knot_interval_m = map_options_.knot_interval_m;  // at level 0
  digest.min_control_point = map_options_.limits.min;
  digest.max_control_point = map_options_.limits.max;
  digest.state = static_cast<int64_t>(state_);
  digest.revision =
      static_cast<int64_t>(is_published ? layer_.revision : changes_.front().after_revision);
  digest.num_tiles = static_cast<int64_t>(index_.num_tiles());
  digest.hash = static_cast<int64_t>(index_.hash());
  digest.root_level = index_.root_level();
  const auto behind_since = is_published ? behind_since_ : changes_.front().since;
  digest.lag_s = behind_since ? std::chrono::duration<double>(now - *behind_since).count() : 0;
  return digest;
}

}  // namespace splinemap
