#include "lib/replication/layer_follower.h"

#include <algorithm>
#include <utility>

#include "absl/container/flat_hash_set.h"
#include "lib/map/validity.h"

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
constexpr int kMaxAsksOfStandIns = 6;    // what the owner had alone is gone with it
// Who hears others ask for the same this often without an answer, asks as well.
constexpr int kMaxPostponed = 10;
// Who begins again in a lesser life when the owner is gone, because its file is an older copy, is
// told that there was a later one.
constexpr milliseconds kObjection(1000);
// A life that nobody speaks of any more, and that was never whole, is given up; one that was heard
// of for less than the probation, sooner.
constexpr milliseconds kGiveUpLife(10'000);
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

LayerFollower::LayerFollower(LayerId id, uint64_t seed, Part part)
    : id_(std::move(id)), part_(part), random_(seed) {}

LayerFollower::LayerFollower(const LayerSnapshot& kept, uint64_t seed, Clock::time_point now)
    : id_(kept.id), random_(seed), last_heard_(now), last_spoken_for_(now) {
  BeginTree(kept.epoch);
  ReplaceTiles(kept);
  is_established_ = true;
}

bool LayerFollower::Admit(const layer_epoch_t& layer) {
  const LayerLife life = FromMessage(layer);
  if (life.id != id_) return false;
  if (epoch_ && life.epoch < *epoch_) {
    ++counts_.stale;
    return false;
  }
  return epoch_ && life.epoch == *epoch_ && life.detail == part_.detail;
}

void LayerFollower::BeginLife(LayerEpoch epoch, Clock::time_point now) {
  // What is shown stays: the last life that was whole, or the first that was heard.
  if (epoch_ && !previous_) {
    previous_ = OwnSnapshot();
    previous_index_ = std::exchange(index_, {});
  }
  BeginTree(epoch);
  life_since_ = now;
}

void LayerFollower::BeginTree(std::optional<LayerEpoch> epoch) {
  ++version_;
  epoch_ = epoch;
  is_established_ = false;
  lesser_was_heard_ = false;
  digest_.reset();
  owners_digest_.reset();
  stand_in_digest_.reset();
  tiles_ = TileTreeEditor();
  index_ = {};
  at_digest_ = {};
  revision_ = 0;
  newest_revision_ = 0;
  wanted_.clear();
  check_.reset();
  checked_hash_.reset();
  checked_nodes_.clear();
  unlisted_.clear();
  unlisted_before_.clear();
  disowned_.clear();
  next_renewal_.reset();
  is_equal_ = false;
  in_sync_ = false;
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

void LayerFollower::HearLife(Clock::time_point now) {
  last_spoken_for_ = now;
  is_established_ |= now - life_since_ >= kProbation;
}

// What is shown is what there is, where the owner and all others are gone before a life was whole,
// or where one was hardly heard of.
void LayerFollower::LookAtLife(Clock::time_point now) {
  const Clock::duration silence = now - last_spoken_for_;
  const bool is_over = previous_ && silence > kGiveUpLife;
  const bool is_mistaken = epoch_ && !is_established_ && silence > kGiveUpOnProbation &&
                           (previous_ || lesser_was_heard_);
  if (!is_over && !is_mistaken) return;
  const std::optional<LayerSnapshot> shown = std::exchange(previous_, std::nullopt);
  previous_index_ = {};
  if (!shown) {
    BeginTree(std::nullopt);
    return;
  }
  BeginTree(shown->epoch);
  ReplaceTiles(*shown);
  is_established_ = true;
}

void LayerFollower::ForgetPreviousLife() {
  if (previous_) ++version_;
  previous_.reset();
  previous_index_ = {};
}

void LayerFollower::TakeDigest(const layer_digest_t& digest, Clock::time_point now) {
  if (digest.protocol_version != kProtocolVersion) {
    ++counts_.foreign;
    return;
  }
  const LayerLife life = FromMessage(digest.layer);
  if (life.id != id_) return;
  if (!epoch_ || life.epoch > *epoch_) BeginLife(life.epoch, now);
  if (life.epoch == *epoch_) {
    last_heard_ = now;
    owner_is_silent_ = false;
    HearLife(now);
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
    wanted_.clear();
  }
  owners_digest_ = digest;
  owners_digest_heard_ = now;
  CompareWith(digest, /*is_owners=*/true, now);
}

void LayerFollower::TakeStandInDigest(const stand_in_digest_t& stand_in, Clock::time_point now) {
  const layer_digest_t& digest = stand_in.digest;
  if (digest.protocol_version != kProtocolVersion) {
    ++counts_.foreign;
    return;
  }
  const LayerLife life = FromMessage(digest.layer);
  if (life.id != id_) return;
  if (epoch_ && life.epoch == *epoch_ && !OwnerIsSilent(now)) return;
  if (!epoch_ || life.epoch > *epoch_) BeginLife(life.epoch, now);
  if (life.epoch == *epoch_) HearLife(now);
  if (!Admit(digest.layer)) return;
  const auto& last = stand_in_digest_;
  if (last && last->daemon_nonce == stand_in.daemon_nonce && digest.utime <= last->digest.utime &&
      digest.utime > last->digest.utime - kMaxLate_us) {
    ++counts_.stale;
    return;
  }
  stand_in_digest_ = stand_in;
  CompareWith(digest, /*is_owners=*/false, now);
}

void LayerFollower::CompareWith(const layer_digest_t& digest, bool is_owners,
                                Clock::time_point now) {
  digest_ = digest;
  at_digest_ = tiles_.Freeze();
  if (!part_.box) in_sync_ = false;  // what changed beside a part says nothing of it
  LookForMatch(now);
  // While something is asked for, it comes first: to list everything anew each time would take the
  // owner's bytes from the tiles.
  if (Matches() || !wanted_.empty()) return;
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
  if (part_.box) return in_sync_ && checked_hash_ == hash;
  return hash == index_.hash() && digest_->num_tiles == static_cast<int64_t>(index_.num_tiles());
}

void LayerFollower::LookForMatch(Clock::time_point now) {
  is_equal_ = Matches();
  std::optional<Check> done;
  if (is_equal_) {
    done = Check{*digest_, now};
    unlisted_.clear();
  } else if (check_ && wanted_.empty()) {
    done = check_;
    is_equal_ = part_.box && unlisted_.empty() && done->digest.hash == digest_->hash;
  }
  if (previous_ && !is_established_) is_equal_ = false;  // it is not what is shown
  if (!done || (previous_ && !is_established_)) return;
  check_.reset();
  wanted_.clear();
  in_sync_ = true;
  last_match_ = done->begin;
  lag_s_ = done->digest.lag_s;
  if (done->is_undisturbed && unlisted_.empty())
    checked_hash_ = static_cast<uint64_t>(done->digest.hash);
  revision_ = static_cast<uint64_t>(done->digest.revision);
  newest_revision_ = std::max(newest_revision_, revision_);
  if (is_equal_) {
    whole_ = OwnSnapshot();
    whole_hash_ = static_cast<uint64_t>(digest_->hash);
  }
  ForgetPreviousLife();
}

// What came after the last digest of an owner that is gone, nobody can vouch for; where the copy
// was never equal to it, what others have as well may still make it so.
void LayerFollower::DropWhatCameLast() {
  if (!owners_digest_ || !whole_ || part_.box || previous_ || whole_->epoch != epoch_ ||
      whole_hash_ != static_cast<uint64_t>(owners_digest_->hash) || index_.hash() == whole_hash_) {
    return;
  }
  ReplaceTiles(*whole_);
}

void LayerFollower::TakeUpdates(const layer_updates_t& updates) {
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
  if (part_.box && !part_.box->Contains(key)) return;
  const ControlLimits limits{static_cast<ControlPoint>(digest_->min_control_point),
                             static_cast<ControlPoint>(digest_->max_control_point)};
  if (!IsInRange(key) || update.revision == 0 ||
      update.revision > static_cast<uint64_t>(digest_->revision) + kMaxAhead) {
    ++counts_.unusable;
    return;
  }
  // Who stands in answers, and does not push.
  if (owner_is_silent_ && !wanted_.contains({0, key.tx, key.ty})) return;
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
  const auto wanted = wanted_.find({0, key.tx, key.ty});
  if (wanted != wanted_.end() && wanted->second.revision <= revision) wanted_.erase(wanted);
  if (!part_.box) return;
  checked_hash_.reset();
  if (check_) check_->is_undisturbed = false;
  NodeKey node{0, key.tx, key.ty};
  while (node.level < HashIndex::kMaxLevel) checked_nodes_.erase(node = node.Parent());
}

void LayerFollower::TakeListing(const layer_listing_t& listing, Clock::time_point now) {
  if (!Admit(listing.layer) || (in_sync_ && !check_)) return;
  if (check_ && listing.state < check_->digest.state) return;  // of before the digest
  for (const node_listing_t& node : listing.nodes) TakeNode(node, now);
}

void LayerFollower::TakeNode(const node_listing_t& listing, Clock::time_point now) {
  const NodeKey node{listing.level, listing.x, listing.y};
  if (node.level < 1 || !node.IsValid()) return;
  // Others ask, too; to take up what they are told would leave no moment in which nothing is
  // wanted.
  if (wanted_.erase(node) == 0) return;
  bool is_equal = true;
  uint64_t hash = 0;
  for (int n = 0; n < listing.num_children; ++n) {
    const auto child_hash = static_cast<uint64_t>(listing.hashes[n]);
    hash += child_hash;
    is_equal &= TakeChild(node.Child(listing.children[n] & 63), child_hash,
                          static_cast<uint64_t>(listing.revisions[n]), now);
  }
  if (check_ && check_->is_owners) is_equal &= !TakeUnlisted(node, listing);
  if (is_equal && !IsWhole(node)) checked_nodes_[node] = hash;
}

bool LayerFollower::TakeUnlisted(const NodeKey& node, const node_listing_t& listing) {
  std::vector<TileKey> unlisted;
  for (const HashIndex::Child& child : index_.ChildrenOf(node)) {
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
  for (const HashIndex::Child& child : index_.ChildrenOf(node)) {
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
  ReplaceTiles({id_, *epoch_, revision_, rest.Freeze()});
  return true;
}

// What was pushed since a list was made is on the next one.
bool LayerFollower::IsDisowned(TileKey key, uint64_t revision) {
  unlisted_[key] = revision;
  const auto before = unlisted_before_.find(key);
  return before != unlisted_before_.end() && before->second == revision;
}

bool LayerFollower::TakeChild(const NodeKey& child, uint64_t hash, uint64_t revision,
                              Clock::time_point now) {
  if (IsOutside(child)) return true;
  const auto checked = checked_nodes_.find(child);
  const bool is_equal = IsWhole(child) ? index_.HashOf(child) == hash
                                       : checked != checked_nodes_.end() && checked->second == hash;
  if (is_equal) {
    wanted_.erase(child);
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
  in_sync_ = false;
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
bool LayerFollower::IsWhole(const NodeKey& node) const {
  if (!part_.box) return true;
  const int64_t side = int64_t{1} << (3 * node.level);
  const TileBox& box = *part_.box;
  return node.x * side >= box.tx0 && (node.x + 1) * side <= box.tx1 && node.y * side >= box.ty0 &&
         (node.y + 1) * side <= box.ty1;
}

bool LayerFollower::IsOutside(const NodeKey& node) const {
  if (!part_.box) return false;
  const int64_t side = int64_t{1} << (3 * node.level);
  const TileBox& box = *part_.box;
  return (node.x + 1) * side <= box.tx0 || node.x * side >= box.tx1 ||
         (node.y + 1) * side <= box.ty0 || node.y * side >= box.ty1;
}

void LayerFollower::TakePull(const layer_pull_t& pull, Clock::time_point now) {
  const LayerLife life = FromMessage(pull.layer);
  if (life.id != id_ || life.epoch != epoch_ || life.detail != part_.detail) return;
  if (next_renewal_) next_renewal_ = now + kRenewal + random_.UpTo(kRenewal);
  next_objection_.reset();  // this pull is one
  for (int n = 0; n < pull.num_nodes; ++n) {
    const auto wanted = wanted_.find({pull.levels[n], pull.xs[n], pull.ys[n]});
    if (wanted == wanted_.end()) continue;
    if (++wanted->second.times_postponed > kMaxPostponed) continue;
    wanted->second.due = std::max(wanted->second.due, now + kRetry + random_.UpTo(kMaxBackOff));
  }
}

void LayerFollower::Want(const NodeKey& node, uint64_t revision, Clock::time_point now) {
  if (wanted_.size() >= kMaxWanted) {
    GiveUpCheck();  // what is left out now, a later digest finds
    return;
  }
  Wanted wanted;
  wanted.due = now + random_.UpTo(kMaxBackOff);
  const auto [known, is_new] = wanted_.try_emplace(node, wanted);
  known->second.revision = std::max(known->second.revision, revision);
}

void LayerFollower::GiveUpCheck() {
  check_.reset();
  in_sync_ = false;
}

std::vector<layer_pull_t> LayerFollower::Tick(Clock::time_point now) {
  std::vector<layer_pull_t> pulls;
  LookAtLife(now);
  if (!epoch_) return pulls;
  if (!std::exchange(owner_is_silent_, OwnerIsSilent(now)) && owner_is_silent_) DropWhatCameLast();
  if (!in_sync_ || check_) LookForMatch(now);
  const int max_asks = OwnerIsSilent(now) ? kMaxAsksOfStandIns : kMaxAsks;
  const size_t given_up = absl::erase_if(wanted_, [&](const auto& wanted) {
    return wanted.second.times_asked >= max_asks && wanted.second.due <= now;
  });
  if (given_up > 0) GiveUpCheck();
  size_t asked = 0;
  for (const auto& [node, wanted] : wanted_) {
    asked += wanted.times_asked > 0 && wanted.due > now ? 1 : 0;
  }
  for (auto& [node, wanted] : wanted_) {
    if (asked >= kMaxAskedAtOnce) break;
    if (wanted.due > now) continue;
    if (pulls.empty() || pulls.back().levels.size() >= kNodesPerPull) {
      pulls.emplace_back().layer = ToMessage(LayerLife{id_, *epoch_, part_.detail});
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
  const auto name_life = [&] {
    if (pulls.empty())
      pulls.emplace_back().layer = ToMessage(LayerLife{id_, *epoch_, part_.detail});
  };
  if (next_objection_ && *next_objection_ <= now) {
    next_objection_.reset();
    name_life();
  }
  if (part_.detail.level > 0 && epoch_ &&
      (!next_renewal_ || *next_renewal_ <= now || !pulls.empty())) {
    next_renewal_ = now + kRenewal + random_.UpTo(kRenewal);
    name_life();
  }
  for (layer_pull_t& pull : pulls) pull.num_nodes = static_cast<int32_t>(pull.levels.size());
  return pulls;
}

LayerSnapshot LayerFollower::Snapshot() { return previous_ ? *previous_ : OwnSnapshot(); }

LayerSnapshot LayerFollower::OwnSnapshot() {
  return {id_, epoch(), newest_revision_, tiles_.Freeze()};
}

}  // namespace splinemap
