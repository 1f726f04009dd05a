#include "lib/replication/layer_follower.h"

#include <algorithm>
#include <utility>

#include "absl/container/flat_hash_set.h"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/node_listing_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/layers/validity.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// What is on its way when a digest comes will mostly be there within this time, and of several
// followers that lack the same one asks first.
constexpr milliseconds kMaxBackOff(100);
constexpr milliseconds kRetry(300);
constexpr size_t kMaxWanted = 20'000;
constexpr size_t kMaxAskedAtOnce = 256;  // tiles and nodes that are asked for and not there yet
constexpr size_t kNodesPerPull = 100;    // so that a pull is one frame
constexpr int kMaxAsks = 32;             // then it is no more believed to exist
constexpr int kMaxAsksOfProxies = 6;     // what the owner had alone is gone with it
// Who hears others ask for the same this often without an answer, asks as well.
constexpr int kMaxPostponed = 10;
// Who begins again in a lesser session when the owner is gone, because its file is an older copy,
// is told that there was a later one.
constexpr milliseconds kObjection(1000);
// A session that nobody speaks of any more, and that was never whole, is given up; one that was
// heard of for less than the probation, sooner.
constexpr milliseconds kGiveUpSession(10'000);
constexpr milliseconds kProbation(2000);
constexpr milliseconds kGiveUpOnProbation(3500);
// Changes that an owner can have pushed since its last digest.
constexpr uint64_t kMaxAhead = uint64_t{1} << 20;
// How often owners have to be told that a coarser level is still wanted.
constexpr milliseconds kRenewal(5000);

constexpr int64_t kMaxLate_us = 5'000'000;
// No message is later than that: a digest of a lesser state that comes then is the owner's, and the
// one before was not.
constexpr milliseconds kMaxLateness(2500);

// Whether a digest is older than one that came before it, or the same. Of one state the time stamps
// tell; but the owner's clock may be set back, which is by more than a message is late.
bool WasOvertaken(const layer_digest_t& digest, const layer_digest_t& last) {
  if (digest.state != last.state) return digest.state < last.state;
  return digest.utime <= last.utime && digest.utime > last.utime - kMaxLate_us;
}

}  // namespace

LayerFollower::LayerFollower(LayerId id, uint64_t seed, Subset part)
    : id_(std::move(id)), subset_(part), random_(seed) {}

LayerFollower::LayerFollower(const LayerSnapshot& kept, uint64_t seed, Clock::time_point now)
    : id_(kept.id), random_(seed), last_heard_(now), last_spoken_for_(now) {
  BeginTree(kept.session);
  ReplaceTiles(kept);
  is_established_ = true;
}

bool LayerFollower::Admit(const layer_ref_t& layer) {
  const LayerRef ref = FromMessage(layer);
  if (ref.id != id_) return false;
  if (session_ && ref.session < *session_) {
    ++counts_.stale;
    return false;
  }
  return session_ && ref.session == *session_ && ref.level_of_detail == subset_.level_of_detail;
}

void LayerFollower::StartSession(SessionId session, Clock::time_point now) {
  // What is shown stays: the last session that was whole, or the first that was heard.
  if (session_ && !previous_) {
    previous_ = OwnSnapshot();
    previous_index_ = std::exchange(index_, {});
  }
  BeginTree(session);
  session_since_ = now;
}

void LayerFollower::BeginTree(std::optional<SessionId> session) {
  ++version_;
  session_ = session;
  is_established_ = false;
  lesser_was_heard_ = false;
  digest_.reset();
  owners_digest_.reset();
  proxy_digest_.reset();
  tiles_ = TileTreeEditor();
  index_ = {};
  at_digest_ = {};
  revision_ = 0;
  newest_revision_ = 0;
  pending_.clear();
  check_.reset();
  checked_hash_.reset();
  checked_nodes_.clear();
  unlisted_.clear();
  unlisted_before_.clear();
  disowned_.clear();
  next_renewal_.reset();
  matches_digest_ = false;
  caught_up_ = false;
}

void LayerFollower::ReplaceTiles(const LayerSnapshot& layer) {
  ++version_;
  tiles_ = TileTreeEditor(layer.tiles);
  index_ = {};
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    index_.Set(key, TileChecksum(key, *entry.tile));
  });
  FindNewestRevision();
  newest_revision_ = std::max(newest_revision_, layer.revision);
  checked_hash_.reset();
  checked_nodes_.clear();
}

void LayerFollower::FindNewestRevision() {
  newest_revision_ = revision_;
  tiles_.tree().ForEach([&](TileKey, const TileTree::Entry& entry) {
    newest_revision_ = std::max(newest_revision_, entry.revision);
  });
}

void LayerFollower::HearSession(Clock::time_point now) {
  last_spoken_for_ = now;
  is_established_ |= now - session_since_ >= kProbation;
}

// What is shown is what there is, where the owner and all others are gone before a session was
// whole, or where one was hardly heard of.
void LayerFollower::CheckSession(Clock::time_point now) {
  const Clock::duration silence = now - last_spoken_for_;
  const bool is_over = previous_ && silence > kGiveUpSession;
  const bool is_mistaken = session_ && !is_established_ && silence > kGiveUpOnProbation &&
                           (previous_ || lesser_was_heard_);
  if (!is_over && !is_mistaken) return;
  const std::optional<LayerSnapshot> shown = std::exchange(previous_, std::nullopt);
  previous_index_ = {};
  if (!shown) {
    BeginTree(std::nullopt);
    return;
  }
  BeginTree(shown->session);
  ReplaceTiles(*shown);
  is_established_ = true;
}

void LayerFollower::ForgetPreviousSession() {
  if (previous_) ++version_;
  previous_.reset();
  previous_index_ = {};
}

void LayerFollower::HandleDigest(const layer_digest_t& digest, Clock::time_point now) {
  if (digest.protocol_version != kProtocolVersion) {
    ++counts_.foreign;
    return;
  }
  if (FromMessage(digest.layer).id != id_) return;
  if (IsOwners(digest)) {
    HandleOwnersDigest(digest, now);
  } else {
    HandleProxyDigest(digest, now);
  }
}

void LayerFollower::HandleOwnersDigest(const layer_digest_t& digest, Clock::time_point now) {
  const LayerRef ref = FromMessage(digest.layer);
  if (!session_ || ref.session > *session_) StartSession(ref.session, now);
  if (ref.session == *session_) {
    last_heard_ = now;
    owner_is_silent_ = false;
    HearSession(now);
    next_objection_.reset();
  } else if (!is_established_) {
    lesser_was_heard_ = true;
  } else if (OwnerIsSilent(now) && !next_objection_) {
    next_objection_ = now + random_.UpTo(kObjection);
  }
  if (!Admit(digest.layer)) return;
  if (owners_digest_ && WasOvertaken(digest, *owners_digest_)) {
    if (now - owners_digest_heard_ <= kMaxLateness) {
      ++counts_.stale;
      return;
    }
    GiveUpCheck();  // with what was no digest of the owner
    pending_.clear();
  }
  owners_digest_ = digest;
  owners_digest_heard_ = now;
  CompareWith(digest, /*is_owners=*/true, now);
}

void LayerFollower::HandleProxyDigest(const layer_digest_t& digest, Clock::time_point now) {
  const LayerRef ref = FromMessage(digest.layer);
  if (session_ && ref.session == *session_ && !OwnerIsSilent(now)) return;
  if (!session_ || ref.session > *session_) StartSession(ref.session, now);
  if (ref.session == *session_) HearSession(now);
  if (!Admit(digest.layer)) return;
  const auto& last = proxy_digest_;
  if (last && last->speaker == digest.speaker && digest.utime <= last->utime &&
      digest.utime > last->utime - kMaxLate_us) {
    ++counts_.stale;
    return;
  }
  proxy_digest_ = digest;
  CompareWith(digest, /*is_owners=*/false, now);
}

void LayerFollower::CompareWith(const layer_digest_t& digest, bool is_owners,
                                Clock::time_point now) {
  digest_ = digest;
  at_digest_ = tiles_.Freeze();
  if (!subset_.box) caught_up_ = false;  // what changed beside a part says nothing of it
  UpdateSync(now);
  // While something is asked for, it comes first: to list everything anew each time would take the
  // owner's bytes from the tiles.
  if (Matches() || !pending_.empty()) return;
  check_ = Check{digest, now, is_owners};
  BeginCheck(now);
}

void LayerFollower::BeginCheck(Clock::time_point now) {
  unlisted_before_ = std::exchange(unlisted_, {});
  const int root_level = digest_->root_level;
  if (check_->is_owners && index_.root_level() > root_level) {
    const int64_t side = int64_t{1} << (3 * root_level);
    const auto is_beyond = [&](int64_t t) { return t < -side || t >= side; };
    std::vector<TileKey> unlisted;
    tiles_.tree().ForEach([&](TileKey key, const TileTree::Entry&) {
      if (is_beyond(key.tx) || is_beyond(key.ty)) unlisted.push_back(key);
    });
    DropDisowned(unlisted);
  }
  for (const int32_t y : {-1, 0}) {
    for (const int32_t x : {-1, 0}) {
      if (!IsOutside({root_level, x, y})) Want({root_level, x, y}, 0, now);
    }
  }
}

bool LayerFollower::Matches() const {
  if (!digest_) return false;
  const auto hash = static_cast<uint64_t>(digest_->hash);
  if (subset_.box) return caught_up_ && checked_hash_ == hash;
  return hash == index_.hash() && digest_->num_tiles == static_cast<int64_t>(index_.num_tiles());
}

void LayerFollower::UpdateSync(Clock::time_point now) {
  matches_digest_ = Matches();
  std::optional<Check> done;
  if (matches_digest_) {
    done = Check{*digest_, now};
    unlisted_.clear();
  } else if (check_ && pending_.empty()) {
    done = check_;
    matches_digest_ = subset_.box && unlisted_.empty() && done->digest.hash == digest_->hash;
  }
  if (previous_ && !is_established_) matches_digest_ = false;  // it is not what is shown
  if (!done || (previous_ && !is_established_)) return;
  check_.reset();
  pending_.clear();
  caught_up_ = true;
  last_match_ = done->begin;
  lag_s_ = done->digest.lag_s;
  if (done->is_undisturbed && unlisted_.empty())
    checked_hash_ = static_cast<uint64_t>(done->digest.hash);
  revision_ = static_cast<uint64_t>(done->digest.revision);
  newest_revision_ = std::max(newest_revision_, revision_);
  if (matches_digest_) {
    synced_ = OwnSnapshot();
    synced_hash_ = static_cast<uint64_t>(digest_->hash);
  }
  ForgetPreviousSession();
}

// What came after the last digest of an owner that is gone, nobody can vouch for; where the copy
// was never equal to it, what others have as well may still make it so.
void LayerFollower::DropWhatCameLast() {
  if (!owners_digest_ || !synced_ || subset_.box || previous_ || synced_->session != session_ ||
      synced_hash_ != static_cast<uint64_t>(owners_digest_->hash) ||
      index_.hash() == synced_hash_) {
    return;
  }
  ReplaceTiles(*synced_);
}

void LayerFollower::HandleUpdates(const layer_updates_t& updates) {
  if (!Admit(updates.layer) || !digest_) return;
  for (const tile_update_t& update : updates.tiles) Apply(update);
}

void LayerFollower::Apply(const tile_update_t& message) {
  const TileUpdate update{{message.tx, message.ty},
                          static_cast<uint64_t>(message.revision),
                          std::string(message.content.begin(), message.content.end()),
                          static_cast<uint64_t>(message.checksum),
                          static_cast<uint64_t>(message.base_checksum)};
  const TileKey key = update.key;
  if (subset_.box && !subset_.box->Contains(key)) return;
  const ControlLimits limits{static_cast<ControlPoint>(digest_->min_control_point),
                             static_cast<ControlPoint>(digest_->max_control_point)};
  if (!IsInRange(key) || update.revision == 0 ||
      update.revision > static_cast<uint64_t>(digest_->revision) + kMaxAhead) {
    ++counts_.unusable;
    return;
  }
  // Who is a proxy answers, and does not push.
  if (owner_is_silent_ && !pending_.contains({0, key.tx, key.ty})) return;
  const Tile* known = tiles_.tree().Find(key);
  const auto disowned = disowned_.find(key);
  const uint64_t least = disowned != disowned_.end() ? disowned->second
                         : known == nullptr          ? 0
                                                     : tiles_.tree().RevisionOf(key) + 1;
  if (update.revision < least) {
    ++counts_.stale;
    return;
  }
  if (IsFull() && known == nullptr) {
    ++counts_.unusable;
    return;
  }
  const absl::StatusOr<Tile> tile = TileOfUpdate(update, FindBase(update));
  if (!tile.ok() || !CheckTile(key, *tile, limits).ok()) {
    ++counts_.unusable;
    return;
  }
  const bool was_disowned = disowned != disowned_.end();
  if (was_disowned) {
    counts_.disowned += known != nullptr && *known != *tile ? 1 : 0;
    disowned_.erase(disowned);
  }
  Keep(key, std::make_shared<const Tile>(*tile), update.revision, update.checksum);
  if (was_disowned) FindNewestRevision();
  ++counts_.applied;
}

const Tile* LayerFollower::FindBase(const TileUpdate& update) const {
  for (const TileTree* tree : {&at_digest_, &tiles_.tree()}) {
    const Tile* tile = tree->Find(update.key);
    if (tile != nullptr && TileChecksum(update.key, *tile) == update.base_checksum) return tile;
  }
  return nullptr;
}

void LayerFollower::Keep(TileKey key, std::shared_ptr<const Tile> tile, uint64_t revision,
                         uint64_t checksum) {
  tiles_.Put(key, std::move(tile), revision);
  index_.Set(key, checksum);
  newest_revision_ = std::max(newest_revision_, revision);
  ++version_;
  const auto wanted = pending_.find({0, key.tx, key.ty});
  if (wanted != pending_.end() && wanted->second.revision <= revision) pending_.erase(wanted);
  if (!subset_.box) return;
  checked_hash_.reset();
  if (check_) check_->is_undisturbed = false;
  NodeKey node{0, key.tx, key.ty};
  while (node.level < HashTree::kMaxLevel) checked_nodes_.erase(node = node.Parent());
}

void LayerFollower::HandleListing(const layer_listing_t& listing, Clock::time_point now) {
  if (!Admit(listing.layer) || (caught_up_ && !check_)) return;
  if (check_ && listing.state < check_->digest.state) return;  // of before the digest
  for (const node_listing_t& node : listing.nodes) HandleNode(node, now);
}

void LayerFollower::HandleNode(const node_listing_t& listing, Clock::time_point now) {
  const NodeKey node{listing.level, listing.x, listing.y};
  if (node.level < 1 || !node.IsValid()) return;
  // Others ask, too; to take up what they are told would leave no moment in which nothing is
  // wanted.
  if (pending_.erase(node) == 0) return;
  bool is_equal = true;
  uint64_t hash = 0;
  for (int n = 0; n < listing.num_children; ++n) {
    const auto child_hash = static_cast<uint64_t>(listing.hashes[n]);
    hash += child_hash;
    is_equal &= HandleChild(node.Child(listing.children[n] & 63), child_hash,
                            static_cast<uint64_t>(listing.revisions[n]), now);
  }
  if (check_ && check_->is_owners) is_equal &= !DropUnlisted(node, listing);
  if (is_equal && !Covers(node)) checked_nodes_[node] = hash;
}

bool LayerFollower::DropUnlisted(const NodeKey& node, const node_listing_t& listing) {
  std::vector<TileKey> unlisted;
  for (const HashTree::Child& child : index_.ChildrenOf(node)) {
    const auto is_child = [&](uint8_t k) { return (k & 63) == child.k; };
    if (child.hash == 0 ||
        std::any_of(listing.children.begin(), listing.children.end(), is_child)) {
      continue;
    }
    FindTiles(node.Child(child.k), unlisted);
  }
  return DropDisowned(unlisted);
}

void LayerFollower::FindTiles(const NodeKey& node, std::vector<TileKey>& keys) const {
  if (node.level == 0) {
    keys.push_back({node.x, node.y});
    return;
  }
  for (const HashTree::Child& child : index_.ChildrenOf(node)) {
    FindTiles(node.Child(child.k), keys);
  }
}

// Drops those that were not listed before either. False where there are none at all.
bool LayerFollower::DropDisowned(const std::vector<TileKey>& unlisted) {
  absl::flat_hash_set<TileKey> dropped;
  for (const TileKey& key : unlisted) {
    if (IsDisowned(key, tiles_.tree().RevisionOf(key))) dropped.insert(key);
  }
  if (dropped.empty()) return !unlisted.empty();
  TileTreeEditor rest;
  tiles_.tree().ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (!dropped.contains(key)) rest.Put(key, entry.tile, entry.revision);
  });
  counts_.disowned += std::ssize(dropped);
  ReplaceTiles({id_, *session_, revision_, rest.Freeze()});
  return true;
}

// What was pushed since a list was made is on the next one.
bool LayerFollower::IsDisowned(TileKey key, uint64_t revision) {
  unlisted_[key] = revision;
  const auto before = unlisted_before_.find(key);
  return before != unlisted_before_.end() && before->second == revision;
}

bool LayerFollower::HandleChild(const NodeKey& child, uint64_t hash, uint64_t revision,
                                Clock::time_point now) {
  if (IsOutside(child)) return true;
  const auto checked = checked_nodes_.find(child);
  const bool is_equal = Covers(child) ? index_.HashOf(child) == hash
                                      : checked != checked_nodes_.end() && checked->second == hash;
  if (is_equal) {
    pending_.erase(child);
    return true;
  }
  if (child.level > 0) {
    Want(child, 0, now);
    return false;
  }
  const TileKey key{child.x, child.y};
  if (!IsInRange(key)) return false;
  if (const uint64_t known = tiles_.tree().RevisionOf(key); known >= revision) {
    if (!check_ || !check_->is_owners) return false;
    if (known > revision && !IsDisowned(key, known)) return false;
    disowned_[key] = revision;
  }
  caught_up_ = false;
  if (IsFull() && tiles_.tree().Find(key) == nullptr) {
    GiveUpCheck();
    return false;
  }
  if (previous_ && previous_index_.HashOf(child) == hash) {
    if (std::shared_ptr<const Tile> equal = previous_->tiles.Share(key)) {
      Keep(key, std::move(equal), revision, hash);
      return true;
    }
  }
  Want(child, revision, now);
  return false;
}

// Nodes are squares of 8^level tiles, so their sides fit into 64 bits.
bool LayerFollower::Covers(const NodeKey& node) const {
  if (!subset_.box) return true;
  const int64_t side = int64_t{1} << (3 * node.level);
  const TileBox& box = *subset_.box;
  return node.x * side >= box.tx0 && (node.x + 1) * side <= box.tx1 && node.y * side >= box.ty0 &&
         (node.y + 1) * side <= box.ty1;
}

bool LayerFollower::IsOutside(const NodeKey& node) const {
  if (!subset_.box) return false;
  const int64_t side = int64_t{1} << (3 * node.level);
  const TileBox& box = *subset_.box;
  return (node.x + 1) * side <= box.tx0 || node.x * side >= box.tx1 ||
         (node.y + 1) * side <= box.ty0 || node.y * side >= box.ty1;
}

void LayerFollower::HandlePull(const layer_pull_t& pull, Clock::time_point now) {
  const LayerRef ref = FromMessage(pull.layer);
  if (ref.id != id_ || ref.session != session_ || ref.level_of_detail != subset_.level_of_detail)
    return;
  if (next_renewal_) next_renewal_ = now + kRenewal + random_.UpTo(kRenewal);
  next_objection_.reset();  // this pull is one
  for (int n = 0; n < pull.num_nodes; ++n) {
    const auto wanted = pending_.find({pull.levels[n], pull.xs[n], pull.ys[n]});
    if (wanted == pending_.end()) continue;
    if (++wanted->second.times_postponed > kMaxPostponed) continue;
    wanted->second.due = std::max(wanted->second.due, now + kRetry + random_.UpTo(kMaxBackOff));
  }
}

void LayerFollower::Want(const NodeKey& node, uint64_t revision, Clock::time_point now) {
  if (pending_.size() >= kMaxWanted) {
    GiveUpCheck();  // what is left out now, a later digest finds
    return;
  }
  PendingPull wanted;
  wanted.due = now + random_.UpTo(kMaxBackOff);
  const auto [known, is_new] = pending_.try_emplace(node, wanted);
  known->second.revision = std::max(known->second.revision, revision);
}

void LayerFollower::GiveUpCheck() {
  check_.reset();
  caught_up_ = false;
}

std::vector<layer_pull_t> LayerFollower::Tick(Clock::time_point now) {
  std::vector<layer_pull_t> pulls;
  CheckSession(now);
  if (!session_) return pulls;
  if (!std::exchange(owner_is_silent_, OwnerIsSilent(now)) && owner_is_silent_) DropWhatCameLast();
  if (!caught_up_ || check_) UpdateSync(now);
  const int max_asks = OwnerIsSilent(now) ? kMaxAsksOfProxies : kMaxAsks;
  const size_t given_up = absl::erase_if(pending_, [&](const auto& wanted) {
    return wanted.second.times_asked >= max_asks && wanted.second.due <= now;
  });
  if (given_up > 0) GiveUpCheck();
  size_t asked = 0;
  for (const auto& [node, wanted] : pending_) {
    asked += wanted.times_asked > 0 && wanted.due > now ? 1 : 0;
  }
  for (auto& [node, wanted] : pending_) {
    if (asked >= kMaxAskedAtOnce) break;
    if (wanted.due > now) continue;
    if (pulls.empty() || pulls.back().levels.size() >= kNodesPerPull) {
      pulls.emplace_back().layer = ToMessage(LayerRef{id_, *session_, subset_.level_of_detail});
    }
    pulls.back().levels.push_back(node.level);
    pulls.back().xs.push_back(node.x);
    pulls.back().ys.push_back(node.y);
    ++(node.level == 0 ? counts_.asked_tiles : counts_.asked_nodes);
    ++asked;
    // Not less and less often: where a third gets lost, half of the asks have no answer.
    wanted.due = now + kRetry + random_.UpTo(kRetry);
    ++wanted.times_asked;
  }
  const auto name_session = [&] {
    if (pulls.empty())
      pulls.emplace_back().layer = ToMessage(LayerRef{id_, *session_, subset_.level_of_detail});
  };
  if (next_objection_ && *next_objection_ <= now) {
    next_objection_.reset();
    name_session();
  }
  if (subset_.level_of_detail.level > 0 && session_ &&
      (!next_renewal_ || *next_renewal_ <= now || !pulls.empty())) {
    next_renewal_ = now + kRenewal + random_.UpTo(kRenewal);
    name_session();
  }
  for (layer_pull_t& pull : pulls) pull.num_nodes = static_cast<int32_t>(pull.levels.size());
  return pulls;
}

Clock::time_point LayerFollower::NextTick(Clock::time_point now) const {
  constexpr milliseconds kWorking(10);
  constexpr milliseconds kIdle(500);  // what depends on silence is not urgent
  if (!pending_.empty()) return now + kWorking;
  Clock::time_point next = now + kIdle;
  if (next_objection_) next = std::min(next, *next_objection_);
  return subset_.level_of_detail.level > 0 && next_renewal_ ? std::min(next, *next_renewal_) : next;
}

LayerSnapshot LayerFollower::Snapshot() { return previous_ ? *previous_ : OwnSnapshot(); }

LayerSnapshot LayerFollower::OwnSnapshot() {
  return {id_, session(), newest_revision_, tiles_.Freeze()};
}

}  // namespace splinemap
