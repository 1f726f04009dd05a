#include "lib/replication/layer_follower.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <tuple>
#include <utility>

#include "absl/container/flat_hash_set.h"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/node_listing_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/archive/scan_record.h"
#include "lib/layers/validity.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// What is on its way when a digest comes will mostly be there within this time, and of several
// followers that lack the same one asks first.
constexpr milliseconds kMaxBackOff(100);
constexpr milliseconds kRetry(300);
constexpr size_t kMaxWanted = 20'000;
// Tiles that are asked for and not there yet: at first so many; one more for each that comes when
// it is asked for, and half of it where one has to be asked for again, since its owner, the network
// or this process cannot keep up.
constexpr size_t kLeastTilesAtOnce = 256;
constexpr size_t kMostTilesAtOnce = 2048;
constexpr size_t kMaxNodesAtOnce = 64;
// While so much of lower levels is wanted, no node is asked for: what is wanted stays far below
// kMaxWanted, however large the layer is, and lasts until the next listing is there.
constexpr size_t kEnoughWanted = 4096;
// To ask is to go through all that is wanted.
constexpr milliseconds kAskInterval(10);
constexpr size_t kNodesPerPull = 100;  // so that a pull is one frame
constexpr int kMaxAsks = 32;           // then it is no more believed to exist
constexpr int kMaxAsksOfProxies = 6;   // what the owner had alone is gone with it
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

// A scan that does not come for so long is given up: tiles tell what it changed.
constexpr int kMaxAsksForScans = 16;
// Folds that were not the owner's so often in a row are made by another version of the method, or
// of what is not the owner's. Tiles are taken for a while.
constexpr int kMaxMisfolds = 3;
constexpr std::chrono::seconds kWithoutScans(60);
constexpr int kMaxOvertakenDigests = 3;
// Scans that are folded in one call, so that nobody waits long for it.
constexpr int kFoldsAtOnce = 32;
// How far a scan changes control points beyond its hits.
constexpr double kMarginKnots = 8;

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

LayerFollower::LayerFollower(LayerId id, uint64_t seed, Subset part,
                             std::shared_ptr<ScanFolder> folder)
    : id_(std::move(id)),
      subset_(part),
      folder_(part.level_of_detail == LevelOfDetail{} ? std::move(folder) : nullptr),
      random_(seed),
      intake_(seed),
      tiles_at_once_(kLeastTilesAtOnce) {}

LayerFollower::LayerFollower(const LayerSnapshot& kept, uint64_t seed, Clock::time_point now,
                             std::shared_ptr<ScanFolder> folder)
    : LayerFollower(kept.id, seed, Subset(), std::move(folder)) {
  last_heard_ = now;
  last_spoken_for_ = now;
  BeginTree(kept.session);
  ReplaceTiles(kept);
  kept_revision_ = kept.revision;
  is_established_ = true;
}

bool LayerFollower::Adopt(const LayerSnapshot& layer, Clock::time_point now) {
  if (session_ && (layer.session < *session_ || !OwnerIsSilent(now))) return false;
  if (layer.tiles.size() > max_tiles_) return false;
  NoteSilence(now);
  if (session_ != layer.session) {
    ForgetPreviousSession();
    BeginTree(layer.session);
    ReplaceTiles(layer);
    session_since_ = now;
    is_established_ = true;
  } else {
    bool is_news = false;
    const TileTree before = tiles_.Freeze();
    TileTree::ForEachDifference(
        before, layer.tiles,
        [&](TileKey key, const TileTree::Entry* ours, const TileTree::Entry* theirs) {
          if (theirs == nullptr || (ours != nullptr && ours->revision >= theirs->revision)) return;
          Keep(key, theirs->tile, theirs->revision, theirs->tile->Checksum(key));
          is_news = true;
        });
    if (is_news) StopFolding();
  }
  kept_revision_ = std::max(kept_revision_, layer.revision);
  newest_revision_ = std::max(newest_revision_, layer.revision);
  last_spoken_for_ = now;
  caught_up_ = true;
  return true;
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
  kept_revision_ = 0;
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
  StopFolding();
  misfolds_ = 0;
  no_scans_until_.reset();
  checked_hash_.reset();
  checked_nodes_.clear();
  unlisted_.clear();
  unlisted_before_.clear();
  disowned_.clear();
  next_renewal_.reset();
}

void LayerFollower::ReplaceTiles(const LayerSnapshot& layer) {
  ++version_;
  tiles_ = TileTreeEditor(layer.tiles);
  index_ = {};
  layer.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    index_.Set(key, entry.tile->Checksum(key));
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
  kept_revision_ = shown->revision;
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
  if (IsRecording(digest)) {
    ++counts_.stale;
    return;
  }
  if (no_scans_until_ && now >= *no_scans_until_) no_scans_until_.reset();
  if (IsOwners(digest)) {
    HandleOwnersDigest(digest, now);
  } else {
    HandleProxyDigest(digest, now);
  }
  FoldWhatIsThere(now);
}

// An owner's of this session that says less than is known of it, or a proxy's from before.
bool LayerFollower::IsRecording(const layer_digest_t& digest) const {
  const LayerRef ref = FromMessage(digest.layer);
  if (!is_signed_ || ref.session != session_ || ref.level_of_detail != subset_.level_of_detail) {
    return false;
  }
  const auto& last = IsOwners(digest) ? owners_digest_ : proxy_digest_;
  if (!IsOwners(digest)) {
    return last && last->speaker == digest.speaker && digest.utime <= last->utime;
  }
  if (static_cast<uint64_t>(digest.revision) < std::max(revision_, kept_revision_)) return true;
  return last && std::tie(digest.state, digest.utime) <= std::tie(last->state, last->utime);
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
  const auto revision = static_cast<uint64_t>(digest.revision);
  if (is_owners) intake_.ForgetAfter(revision);  // what it did not send yet, others did
  digest_is_ahead_ = IsFolding() && *folded_ < revision;
  if (digest_is_ahead_) {
    caught_up_ = false;
    matches_digest_ = false;
  } else {
    Compare(is_owners, now);
  }
}

// With what the last digest says. While scans are folded and it is of the whole layer, hashes can
// only be compared where both are of the same commit.
void LayerFollower::Compare(bool is_owners, Clock::time_point now) {
  const layer_digest_t& digest = *digest_;
  if (IsFolding()) {
    // A digest that scans have overtaken tells nothing; several tell that they are not the owner's.
    const bool is_overtaken = *folded_ > static_cast<uint64_t>(digest.revision);
    overtaken_digests_ = is_overtaken && is_owners ? overtaken_digests_ + 1 : 0;
    const bool is_false =
        overtaken_digests_ >= kMaxOvertakenDigests || (!is_overtaken && !subset_.box && !Matches());
    if (is_false) {
      CountMisfold(now);
    } else if (is_overtaken && !subset_.box) {
      matches_digest_ = Matches();
      return;
    }
  }
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
  if (IsFolding() && (digest_is_ahead_ || done->is_open)) {
    // What was compared is not all of it, or not of the commit that is here.
    matches_digest_ = false;
    check_.reset();
    return;
  }
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
    misfolds_ = 0;
  }
  if (!IsFolding() && IsOwners(done->digest) && unlisted_.empty()) {
    folded_ = revision_;
    intake_.ForgetUpTo(revision_);
  }
  ForgetPreviousSession();
}

void LayerFollower::StopFolding() {
  folded_.reset();
  sends_scans_ = false;  // until the next one comes
  digest_is_ahead_ = false;
  overtaken_digests_ = 0;
  intake_.Clear();
  recent_scans_.Clear();
  pending_.clear();
  check_.reset();
  matches_digest_ = false;
  caught_up_ = false;
}

void LayerFollower::CountMisfold(Clock::time_point now) {
  ++counts_.misfolded;
  if (++misfolds_ >= kMaxMisfolds) {
    misfolds_ = 0;
    no_scans_until_ = now + kWithoutScans;
  }
  StopFolding();
}

void LayerFollower::HandleScans(const layer_scans_t& scans, Clock::time_point now) {
  if (!Admit(scans.layer) || !digest_) return;
  // An empty message only tells that what was asked for cannot be had.
  const bool is_owners = scans.speaker == scans.layer.session_nonce && !scans.scans.empty();
  if (is_owners && !std::exchange(sends_scans_, true) && folded_ && TakesScans()) {
    pending_.clear();  // scans tell from here on
    check_.reset();
  }
  if (!TakesScans()) return;
  const auto told = static_cast<uint64_t>(digest_->revision);
  const uint64_t known = folded_  ? *folded_
                         : check_ ? static_cast<uint64_t>(check_->digest.revision)
                                  : told;
  // Where the owner is silent, others can only send what somebody vouches for.
  const uint64_t last = owner_is_silent_ ? told : told + kMaxAhead;
  for (const scan_record_t& scan : scans.scans) {
    const auto revision = static_cast<uint64_t>(scan.revision);
    if (revision > last) {
      ++counts_.unusable;
    } else if (revision <= known || !intake_.Add(scan)) {
      ++counts_.stale;
    }
  }
  FoldWhatIsThere(now);
  const bool is_lost = IsFolding() && intake_.times_asked() > 0 &&
                       static_cast<uint64_t>(scans.oldest) > *folded_ + 1;
  if (is_lost) StopFolding();
}

void LayerFollower::FoldWhatIsThere(Clock::time_point now) {
  for (int n = 0; n < kFoldsAtOnce && IsFolding(); ++n) {
    std::optional<SentScan> scan = intake_.Take(*folded_ + 1);
    if (!scan) break;
    if (!Fold(*scan)) {
      ++counts_.unusable;
      break;
    }
    recent_scans_.Add(*std::move(scan));
    if (digest_is_ahead_ && *folded_ == static_cast<uint64_t>(digest_->revision)) {
      digest_is_ahead_ = false;
      Compare(IsOwners(*digest_), now);
    }
  }
  if (!IsFolding() || intake_.Has(*folded_ + 1)) return;
  intake_.SetGap(*folded_, std::max(intake_.newest(), static_cast<uint64_t>(digest_->revision)),
                 now);
}

// Tiles that are later than the scan, from updates, have it already. False for what no owner can
// have mapped.
bool LayerFollower::Fold(const SentScan& scan) {
  absl::StatusOr<UnpackedBeams> beams =
      UnpackBeams({reinterpret_cast<const uint8_t*>(scan.beams.data()), scan.beams.size()});
  if (!beams.ok()) return false;
  beams->scan.utime = scan.utime;
  beams->scan.world_T_robot = scan.layer_T_robot;
  Place(beams->scan, FixedPose2(), placed_);
  if (!folder_->Check(placed_).ok()) return false;
  folded_ = scan.revision;
  newest_revision_ = std::max(newest_revision_, scan.revision);
  ++counts_.folded;
  if (IsBeside(placed_)) return true;
  fold_edits_.clear();
  folder_->Fold(placed_, beams->model, scan.revision, tiles_, [&](TileKey key) {
    if (subset_.box && !subset_.box->Contains(key)) return false;
    const bool is_known = tiles_.tree().Find(key) != nullptr;
    if (is_known ? tiles_.tree().RevisionOf(key) >= scan.revision : IsFull()) return false;
    fold_edits_.push_back(key);
    return true;
  });
  for (const TileKey key : fold_edits_) {
    index_.Set(key, tiles_.tree().Find(key)->Checksum(key));
    NoteChange(key);
  }
  if (!fold_edits_.empty()) ++version_;
  return true;
}

// Whether it changes nothing of the part.
bool LayerFollower::IsBeside(const PlacedScan& scan) const {
  if (!subset_.box || scan.beams.empty()) return false;
  Eigen::AlignedBox2d box_m;
  for (const PlacedBeam& beam : scan.beams) {
    box_m.extend(beam.origin_world_m);
    box_m.extend(beam.origin_world_m + beam.range_m * beam.direction_world);
  }
  const double tile_m = Tile::kSide * folder_->options().knot_interval_m;
  const double margin_m = kMarginKnots * folder_->options().knot_interval_m;
  const Eigen::AlignedBox2d part_m(Eigen::Vector2d(subset_.box->tx0, subset_.box->ty0) * tile_m,
                                   Eigen::Vector2d(subset_.box->tx1, subset_.box->ty1) * tile_m);
  const Eigen::Vector2d margin(margin_m, margin_m);
  return !Eigen::AlignedBox2d(box_m.min() - margin, box_m.max() + margin).intersects(part_m);
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
  if (!folded_) return;
  folded_ = revision_;
  digest_is_ahead_ = false;
  intake_.Clear();
  recent_scans_.DropAfter(revision_);
}

void LayerFollower::HandleUpdates(const layer_updates_t& updates) {
  if (!Admit(updates.layer) || !digest_ || IsFolding()) return;
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
  const StoredTile* known = tiles_.tree().Find(key);
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
  const absl::StatusOr<Tile> tile = TileOfUpdate(update, FindBase(update).get());
  if (!tile.ok() || !CheckTile(key, *tile, limits).ok()) {
    ++counts_.unusable;
    return;
  }
  const bool was_disowned = disowned != disowned_.end();
  if (was_disowned) {
    counts_.disowned += known != nullptr && *known->Get() != *tile ? 1 : 0;
    disowned_.erase(disowned);
  }
  Keep(key, std::make_shared<const StoredTile>(*tile), update.revision, update.checksum);
  if (was_disowned) FindNewestRevision();
  ++counts_.applied;
}

std::shared_ptr<const Tile> LayerFollower::FindBase(const TileUpdate& update) const {
  for (const TileTree* tree : {&at_digest_, &tiles_.tree()}) {
    const StoredTile* tile = tree->Find(update.key);
    if (tile != nullptr && tile->Checksum(update.key) == update.base_checksum) return tile->Get();
  }
  return nullptr;
}

void LayerFollower::Keep(TileKey key, std::shared_ptr<const StoredTile> tile, uint64_t revision,
                         uint64_t checksum) {
  tiles_.Put(key, std::move(tile), revision);
  index_.Set(key, checksum);
  newest_revision_ = std::max(newest_revision_, revision);
  ++version_;
  const auto wanted = pending_.find({0, key.tx, key.ty});
  if (wanted != pending_.end() && wanted->second.revision <= revision) {
    if (wanted->second.times_asked == 1)
      tiles_at_once_ = std::min(tiles_at_once_ + 1, kMostTilesAtOnce);
    pending_.erase(wanted);
  }
  NoteChange(key);
}

// Of a part, what was compared before says nothing any more.
void LayerFollower::NoteChange(TileKey key) {
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
  const uint64_t known = tiles_.tree().RevisionOf(key);
  if (IsFolding()) {
    // Scans that are on their way will make it equal, or have changed it since it was listed.
    if (revision <= *folded_ && known <= revision) CountMisfold(now);
    if (check_) check_->is_open = true;
    return false;
  }
  if (known >= revision) {
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
    if (std::shared_ptr<const StoredTile> equal = previous_->tiles.Share(key)) {
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
  // Of tiles as they were mapped, pushes are asked for by a pull of no nodes alone.
  if (next_renewal_ && (pull.num_nodes == 0 || subset_.level_of_detail.level > 0)) {
    next_renewal_ = now + kRenewal + random_.UpTo(kRenewal);
  }
  next_objection_.reset();  // this pull is one
  for (int n = 0; n < pull.num_nodes; ++n) {
    const auto wanted = pending_.find({pull.levels[n], pull.xs[n], pull.ys[n]});
    if (wanted == pending_.end()) continue;
    if (++wanted->second.times_postponed > kMaxPostponed) continue;
    wanted->second.due = std::max(wanted->second.due, now + kRetry + random_.UpTo(kMaxBackOff));
  }
}

void LayerFollower::HandleScanPull(const scan_pull_t& pull, Clock::time_point now) {
  const LayerRef ref = FromMessage(pull.layer);
  if (ref.id == id_ && ref.session == session_) intake_.HandlePull(pull, now);
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

LayerFollower::Pulls LayerFollower::Tick(Clock::time_point now) {
  Pulls pulls;
  CheckSession(now);
  if (!session_) return pulls;
  NoteSilence(now);
  if (!caught_up_ || check_) UpdateSync(now);
  FoldWhatIsThere(now);
  if (now >= next_ask_) {
    next_ask_ = now + kAskInterval;
    AskForWanted(now, pulls.nodes);
  }
  TellOwner(now, pulls.nodes);
  for (layer_pull_t& pull : pulls.nodes) pull.num_nodes = static_cast<int32_t>(pull.levels.size());
  const int max_scan_asks = OwnerIsSilent(now) ? kMaxAsksOfProxies : kMaxAsksForScans;
  if (IsFolding() && intake_.times_asked() >= max_scan_asks && *intake_.next_ask() <= now) {
    StopFolding();
  }
  if (IsFolding()) pulls.scans = intake_.Ask(now);
  if (pulls.scans) {
    pulls.scans->layer = ToMessage(LayerRef{id_, *session_, {}});
    ++counts_.asked_scans;
  }
  return pulls;
}

void LayerFollower::NoteSilence(Clock::time_point now) {
  if (std::exchange(owner_is_silent_, OwnerIsSilent(now)) || !owner_is_silent_) return;
  DropWhatCameLast();
  intake_.ForgetGap();  // proxies are asked anew
}

void LayerFollower::AddPull(std::vector<layer_pull_t>& pulls) const {
  pulls.emplace_back().layer = ToMessage(LayerRef{id_, *session_, subset_.level_of_detail});
}

void LayerFollower::AskForWanted(Clock::time_point now, std::vector<layer_pull_t>& pulls) {
  const int max_asks = OwnerIsSilent(now) ? kMaxAsksOfProxies : kMaxAsks;
  const size_t given_up = absl::erase_if(pending_, [&](const auto& wanted) {
    return wanted.second.times_asked >= max_asks && wanted.second.due <= now;
  });
  if (given_up > 0) GiveUpCheck();
  std::array<size_t, HashTree::kMaxLevel + 1> wanted_of_level{};
  size_t tiles = 0;
  size_t nodes = 0;
  for (const auto& [node, wanted] : pending_) {
    ++wanted_of_level[node.level];
    if (wanted.times_asked > 0 && wanted.due > now) ++(node.level == 0 ? tiles : nodes);
  }
  int max_level = 0;
  for (size_t lower = wanted_of_level[0];
       lower < kEnoughWanted && max_level < HashTree::kMaxLevel;) {
    lower += wanted_of_level[++max_level];
  }
  bool is_repeated = false;
  for (auto& [node, wanted] : pending_) {
    if (wanted.due > now || node.level > max_level) continue;
    if (node.level == 0 ? tiles >= tiles_at_once_ : nodes >= kMaxNodesAtOnce) continue;
    is_repeated |= node.level == 0 && wanted.times_asked > 0;
    if (pulls.empty() || pulls.back().levels.size() >= kNodesPerPull) AddPull(pulls);
    pulls.back().levels.push_back(node.level);
    pulls.back().xs.push_back(node.x);
    pulls.back().ys.push_back(node.y);
    ++(node.level == 0 ? counts_.asked_tiles : counts_.asked_nodes);
    ++(node.level == 0 ? tiles : nodes);
    // Not less and less often: where a third gets lost, half of the asks have no answer.
    wanted.due = now + kRetry + random_.UpTo(kRetry);
    ++wanted.times_asked;
  }
  if (is_repeated) tiles_at_once_ = std::max(tiles_at_once_ / 2, kLeastTilesAtOnce);
}

// That its session is lesser than the one here, or that pushes are still wanted.
void LayerFollower::TellOwner(Clock::time_point now, std::vector<layer_pull_t>& pulls) {
  if (next_objection_ && *next_objection_ <= now) {
    next_objection_.reset();
    if (pulls.empty()) AddPull(pulls);
  }
  if (!RenewsPushes()) return;
  const bool is_coarser = subset_.level_of_detail.level > 0;
  const bool is_due = !next_renewal_ || *next_renewal_ <= now;
  if (!is_due && !(is_coarser && !pulls.empty())) return;
  next_renewal_ = now + kRenewal + random_.UpTo(kRenewal);
  // Any pull of a coarser level will do; pushes are asked for by one of no nodes.
  if (pulls.empty() || (!is_coarser && !pulls.back().levels.empty())) AddPull(pulls);
}

Clock::time_point LayerFollower::NextTick(Clock::time_point now) const {
  constexpr milliseconds kIdle(500);  // what depends on silence is not urgent
  if (IsFolding() && intake_.Has(*folded_ + 1)) return now;
  if (!pending_.empty()) return std::max(next_ask_, now);
  Clock::time_point next = now + kIdle;
  if (next_objection_) next = std::min(next, *next_objection_);
  if (RenewsPushes() && next_renewal_) next = std::min(next, *next_renewal_);
  if (const auto ask = intake_.next_ask()) next = std::min(next, *ask);
  return next;
}

LayerSnapshot LayerFollower::Snapshot() { return previous_ ? *previous_ : OwnSnapshot(); }

LayerSnapshot LayerFollower::OwnSnapshot() {
  return {id_, session(), newest_revision_, tiles_.Freeze()};
}

}  // namespace splinemap
