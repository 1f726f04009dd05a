#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_ref_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/node_listing_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/mapping/scan_folder.h"
#include "lib/replication/hash_tree.h"
#include "lib/replication/protocol.h"
#include "lib/replication/random_backoff.h"
#include "lib/replication/recent_scans.h"
#include "lib/replication/scan_intake.h"
#include "lib/tiles/tile_codec.h"
#include "splinemap/follow_options.h"
#include "splinemap/layer.h"
#include "splinemap/level_of_detail.h"
#include "splinemap/region.h"

namespace splinemap {

// The follower's side of the protocol for one layer at one level of detail: a copy of what the
// owner has published, or of a part of it, made of whatever messages arrive, in any order and as
// often as they like. Digests tell whether it is the whole; where not, it pulls what differs. Of a
// part, and only then, every new digest makes it ask for hashes down to the part.
//
// A copy that was equal to the owner's goes on by folding the scans that the owner sends, each once
// all before it are there; those that got lost are pulled by number. It takes no tiles then, until
// a digest shows that it is another copy, or scans cannot be had any more.
//
// Anybody can write messages in the owner's name, so what a single one says is not believed for
// long: a new session of the owner replaces the one before after two seconds of digests; a tile
// that the owner does not list in two checks is dropped, or fetched anew; and what came after the
// last digest of an owner that fell silent is dropped where the copy was equal at that digest.
// Without clocks, threads or sockets of its own. Thread-compatible.
class LayerFollower {
 public:
  // An owner that has said nothing for so long is gone.
  static constexpr std::chrono::milliseconds kOwnerTimeout{3000};

  struct Subset {
    LevelOfDetail level_of_detail;
    std::optional<TileBox> box;  // of that level; none: all tiles
  };

  // `seed` spreads the times at which followers ask. Of all tiles as they were mapped, or a part of
  // them, scans are taken where there is a `folder`; several followers may share it.
  LayerFollower(LayerId id, uint64_t seed) : LayerFollower(std::move(id), seed, Subset()) {}
  LayerFollower(LayerId id, uint64_t seed, Subset part,
                std::shared_ptr<ScanFolder> folder = nullptr);
  // Begins with a copy that was kept, of all tiles, and `now` as if the owner had just been heard.
  LayerFollower(const LayerSnapshot& kept, uint64_t seed, Clock::time_point now,
                std::shared_ptr<ScanFolder> folder = nullptr);

  // Takes a copy that came another way than over this bus, of an owner that is silent here: as a
  // whole where it is of a later session, else those tiles that are newer. False where the owner is
  // heard, or in a later session.
  bool Adopt(const LayerSnapshot& layer, Clock::time_point now);

  // Beyond, tiles are not taken, and the copy is never in sync.
  void SetMaxTiles(size_t max_tiles) { max_tiles_ = max_tiles; }

  // Digests are those of owners and proxies whose keys are trusted, or recorded ones: what is older
  // than what came before is ignored for good, and shows nobody to be there.
  void SetSigned(bool is_signed) { is_signed_ = is_signed; }

  // Messages of other layers and other levels are ignored, but for digests of the layer as it was
  // mapped: a follower of a coarser level learns from them whom to ask.
  // Those of proxies are ignored as long as the owner itself speaks.
  void HandleDigest(const layer_digest_t& digest, Clock::time_point now);
  void HandleUpdates(const layer_updates_t& updates);
  void HandleListing(const layer_listing_t& listing, Clock::time_point now);
  void HandleScans(const layer_scans_t& scans, Clock::time_point now);
  // Another follower asks: the answer will come here, too.
  void HandlePull(const layer_pull_t& pull, Clock::time_point now);
  void HandleScanPull(const scan_pull_t& pull, Clock::time_point now);

  // What is to be asked now. Call it some times a second.
  struct Pulls {
    std::vector<layer_pull_t> nodes;
    std::optional<scan_pull_t> scans;
  };
  Pulls Tick(Clock::time_point now);
  // When that will have something to do, if nothing comes before.
  Clock::time_point NextTick(Clock::time_point now) const;

  // The copy. Of a new session of the owner it is shown from the first moment in which it is whole
  // and was spoken of for two seconds; until then, what the session before left.
  LayerSnapshot Snapshot();
  // Counts on when that changes.
  uint64_t version() const { return version_; }
  // Whether that is of a session before.
  bool ShowsPreviousSession() const { return previous_.has_value(); }
  void ForgetPreviousSession();

  // The copy when a digest matched for the last time; nothing where none has. Of a part: when all
  // of it was found to match.
  const std::optional<LayerSnapshot>& synced() const { return synced_; }

  SessionId session() const { return session_.value_or(SessionId{}); }
  uint64_t revision() const { return revision_; }  // of the digest with which it was in sync, or 0
  size_t num_tiles() const { return index_.num_tiles(); }
  uint64_t hash() const { return index_.hash(); }  // as in digests

  // Whether the last digest matched: the copy is a state that the owner was in, with later changes
  // beside it at most.
  bool matches_digest() const { return matches_digest_; }

  // Whether all that a digest told of is there, and no later digest has shown that something is
  // missing: it matched, or what differed was compared with the owner's and is the owner's or
  // newer. When the last such digest came, and how long the owner's oldest change had waited to be
  // published then.
  bool caught_up() const { return caught_up_; }
  double lag_s() const { return lag_s_; }
  std::optional<Clock::time_point> last_match() const { return last_match_; }

  // Its owner in the present session; or that or a proxy for it.
  Clock::time_point last_heard() const { return last_heard_; }
  Clock::time_point last_spoken_for() const { return last_spoken_for_; }
  // Whether nothing of it would be missed: it was never heard, or has no tiles.
  bool IsEmpty() const { return tiles_.tree().size() == 0 && !previous_; }
  bool OwnerWasHeard() const { return owners_digest_.has_value(); }
  bool OwnerIsSilent(Clock::time_point now) const { return now - last_heard_ > kOwnerTimeout; }

  const FollowCounts& counts() const { return counts_; }
  // Those that were folded last, in this session.
  RecentScans& recent_scans() { return recent_scans_; }

 private:
  struct PendingPull {
    Clock::time_point due;
    uint64_t revision = 0;  // of a tile: that one or a newer
    int times_asked = 0;
    int times_postponed = 0;
  };

  void HandleOwnersDigest(const layer_digest_t& digest, Clock::time_point now);
  void HandleProxyDigest(const layer_digest_t& digest, Clock::time_point now);
  bool IsRecording(const layer_digest_t& digest) const;
  // False where the message is none of this layer's present session. Sessions begin with a digest.
  bool Admit(const layer_ref_t& layer);
  void StartSession(SessionId session, Clock::time_point now);
  void BeginTree(std::optional<SessionId> session);
  void ReplaceTiles(const LayerSnapshot& layer);
  void FindNewestRevision();
  void HearSession(Clock::time_point now);
  void CheckSession(Clock::time_point now);
  void NoteSilence(Clock::time_point now);
  void DropWhatCameLast();
  void CompareWith(const layer_digest_t& digest, bool is_owners, Clock::time_point now);
  void Apply(const tile_update_t& message);
  std::shared_ptr<const Tile> FindBase(const TileUpdate& update) const;
  bool IsFull() const { return tiles_.tree().size() >= max_tiles_; }
  void Keep(TileKey key, std::shared_ptr<const StoredTile> tile, uint64_t revision,
            uint64_t checksum);
  void HandleNode(const node_listing_t& listing, Clock::time_point now);
  void Want(const NodeKey& node, uint64_t revision, Clock::time_point now);
  void GiveUpCheck();
  // Whether what is there is equal; if not, it is asked for.
  bool HandleChild(const NodeKey& child, uint64_t hash, uint64_t revision, Clock::time_point now);
  // What is there and not on the owner's list. False where that is nothing.
  bool DropUnlisted(const NodeKey& node, const node_listing_t& listing);
  void FindTiles(const NodeKey& node, std::vector<TileKey>& keys) const;
  bool DropDisowned(const std::vector<TileKey>& unlisted);
  bool IsDisowned(TileKey key, uint64_t revision);
  bool Covers(const NodeKey& node) const;     // all of it is in the part
  bool IsOutside(const NodeKey& node) const;  // nothing of it is
  void BeginCheck(Clock::time_point now);
  bool Matches() const;
  void UpdateSync(Clock::time_point now);
  LayerSnapshot OwnSnapshot();
  void Compare(bool is_owners, Clock::time_point now);
  void NoteChange(TileKey key);
  bool TakesScans() const { return folder_ != nullptr && !no_scans_until_; }
  bool IsFolding() const { return folded_.has_value() && sends_scans_ && TakesScans(); }
  void StopFolding();
  void CountMisfold(Clock::time_point now);
  void FoldWhatIsThere(Clock::time_point now);
  bool Fold(const SentScan& scan);
  bool IsBeside(const PlacedScan& scan) const;
  bool RenewsPushes() const {
    return subset_.level_of_detail.level > 0 || (sends_scans_ && !TakesScans());
  }
  void AddPull(std::vector<layer_pull_t>& pulls) const;
  void AskForWanted(Clock::time_point now, std::vector<layer_pull_t>& pulls);
  void TellOwner(Clock::time_point now, std::vector<layer_pull_t>& pulls);

  const LayerId id_;
  const Subset subset_;
  std::shared_ptr<ScanFolder> folder_;
  RandomBackoff random_;
  size_t max_tiles_ = size_t{1} << 20;  // 2 GiB

  bool is_signed_ = false;
  uint64_t kept_revision_ = 0;  // of the copy that it began with, in its session

  std::optional<SessionId> session_;
  Clock::time_point session_since_;       // when it was first heard of
  bool is_established_ = false;           // it was heard of for kProbation
  bool lesser_was_heard_ = false;         // an owner in a lesser session, while it was not
  bool owner_is_silent_ = false;          // as of the last Tick()
  std::optional<layer_digest_t> digest_;  // the last of this session
  std::optional<layer_digest_t> owners_digest_;
  Clock::time_point owners_digest_heard_;
  std::optional<layer_digest_t> proxy_digest_;
  TileTreeEditor tiles_;
  HashTree index_;      // of tiles_
  TileTree at_digest_;  // tiles_ when the last digest came
  uint64_t revision_ = 0;
  uint64_t newest_revision_ = 0;  // of any tile
  std::optional<LayerSnapshot> synced_;
  uint64_t synced_hash_ = 0;

  // What the session before left: shown until this one is whole, and a source of equal tiles.
  std::optional<LayerSnapshot> previous_;
  HashTree previous_index_;

  // Every tile is as the owner had it in commit `folded_`, or in that of its revision where that is
  // later; nothing where that is not known.
  std::optional<uint64_t> folded_;
  bool sends_scans_ = false;  // the owner does, as far as was heard
  ScanIntake intake_;
  RecentScans recent_scans_;
  bool digest_is_ahead_ = false;  // digest_, of the scans that were folded
  int overtaken_digests_ = 0;     // by these scans, in a row
  int misfolds_ = 0;              // in a row
  std::optional<Clock::time_point> no_scans_until_;
  PlacedScan placed_;                // of Fold(); kept for its memory
  std::vector<TileKey> fold_edits_;  // the same

  absl::flat_hash_map<NodeKey, PendingPull> pending_;
  Clock::time_point next_ask_;
  size_t tiles_at_once_;
  // The digest whose hashes are being compared, until nothing of it is wanted any more.
  struct Check {
    layer_digest_t digest;
    Clock::time_point begin;
    bool is_owners = false;
    bool is_undisturbed = true;  // no tile has changed since
    // A tile differed that scans on their way will make equal, or have changed since.
    bool is_open = false;
  };
  std::optional<Check> check_;
  // Tiles with revisions that the owner did not list in this check and in the one before: it has
  // pushed them since, or never.
  absl::flat_hash_map<TileKey, uint64_t> unlisted_;
  absl::flat_hash_map<TileKey, uint64_t> unlisted_before_;
  // Of tiles that the owner never had like this, which revision it lists.
  absl::flat_hash_map<TileKey, uint64_t> disowned_;
  // Of a part, for as long as no tile changes: the hash of the last digest that matched, and of
  // nodes that lie partly in it the hash at which what is in it matched.
  std::optional<uint64_t> checked_hash_;
  absl::flat_hash_map<NodeKey, uint64_t> checked_nodes_;
  std::optional<Clock::time_point> next_renewal_;
  Clock::time_point last_heard_;                     // an owner's digest of this session
  Clock::time_point last_spoken_for_;                // a digest of this session
  std::optional<Clock::time_point> next_objection_;  // to a lesser session
  uint64_t version_ = 0;
  bool matches_digest_ = false;
  bool caught_up_ = false;
  double lag_s_ = 0;  // at last_match_
  std::optional<Clock::time_point> last_match_;
  FollowCounts counts_;
};

}  // namespace splinemap
