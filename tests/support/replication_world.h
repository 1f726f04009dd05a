#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <random>
#include <vector>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/archive/scan_record.h"
#include "lib/layers/layer_pyramid.h"
#include "lib/replication/byte_budget.h"
#include "lib/replication/layer_follower.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/replication/session_guard.h"
#include "lib/tiles/tile_codec.h"
#include "tests/support/lossy_network.h"
#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"
#include "tests/support/scan_mapper.h"

namespace splinemap::replication_test {

using std::chrono::milliseconds;
using Random = std::mt19937_64;

inline constexpr milliseconds kStep = Network::kStep;
inline const LayerId kId{"robot", 7};
inline const MapOptions kMapOptions{0.05, {}};
inline const Clock::time_point kNow{std::chrono::hours(1)};

// What a publisher sends where the budget does not matter.
inline std::vector<ReplicationMessage> TickOf(PyramidPublisher& publisher, Clock::time_point now) {
  ByteBudget budget(PublisherOptions().bytes_per_s);
  budget.Refill(now, publisher.HasChanges(), publisher.HasPulls());
  return publisher.Tick(now, budget);
}

// What the commits of an owner are made of.
enum class Commits { kTiles, kScans };

// Of all tests: it takes some time to make.
inline std::shared_ptr<ScanFolder> Folder() {
  static const auto& folder =
      *new std::shared_ptr<ScanFolder>(std::make_shared<ScanFolder>(kMapOptions));
  return folder;
}

// An owner with its map, and followers, on one network.
class World {
 public:
  World(Weather weather, PublisherOptions options, uint64_t seed, Commits commits = Commits::kTiles)
      : network_(weather, seed), options_(options), commits_(commits), random_(seed + 1) {
    StartOwner(nullptr);
  }

  Network& network() { return network_; }
  Random& random() { return random_; }
  size_t num_followers() const { return followers_.size(); }
  LayerFollower& follower(size_t n) { return *followers_[n]; }

  // It folds scans with `folder`, or takes tiles where that is null.
  void AddFollower(LayerFollower::Subset subset = {},
                   std::shared_ptr<ScanFolder> folder = Folder()) {
    subsets_.push_back(subset);
    folders_.push_back(std::move(folder));
    followers_.push_back(nullptr);
    RestartFollower(followers_.size() - 1);
  }
  void RemoveFollowers() {
    subsets_.clear();
    folders_.clear();
    followers_.clear();
  }
  // Messages that are on their way to the one before are lost.
  void RestartFollower(size_t n) {
    followers_[n] = std::make_shared<LayerFollower>(kId, random_(), subsets_[n], folders_[n]);
  }

  // Goes on from an older state, and knows no later session than that; or from an empty one.
  void StartOwner(const LayerSnapshot* file) {
    const uint64_t last = file == nullptr ? session_number_ : file->session.number;
    const SessionId session{last + 1, random_()};
    session_number_ = std::max(session_number_, session.number);
    guard_ = {};
    map_ = std::make_unique<MapWriter>(kMapOptions);
    layer_ = file == nullptr ? &map_->AddLayer(kId, session) : &map_->ContinueLayer(*file, session);
    mapper_.emplace(Folder());
    Publish();
  }
  LayerSnapshot OwnersLayer() {
    return commits_ == Commits::kScans ? mapper_->SnapshotOf(*layer_) : layer_->Snapshot();
  }
  PyramidPublisher& publisher() { return *publisher_; }
  void SilenceOwner(bool is_silent) { is_silent_ = is_silent; }

  // Requires an owner that maps scans.
  void Map(const PosedScan& scan) {
    publisher_->AddScan(ScanMapper::SentOf(scan, *layer_), network_.now());
    // It may be sent before it is mapped.
    if (!is_silent_ && random_() % 2 == 0) Speak();
    mapper_->Map(scan, *layer_);
  }

  // Some tiles within `half_width` of the origin.
  void Commit(int half_width) {
    if (commits_ == Commits::kScans) {
      Map(RandomScan(random_, 1.6 * half_width));
      return;
    }
    layer_->BeginCommit();
    for (int n = 0; n < 4; ++n) {
      Tile& tile = layer_->EditTile(RandomKey(random_, half_width));
      for (int k = 0; k < 40; ++k) {
        tile.control_points[random_() % Tile::kSize] =
            static_cast<ControlPoint>(1 + random_() % 1000);
      }
    }
  }

  void SetTile(TileKey key, ControlPoint value) {
    layer_->BeginCommit();
    layer_->EditTile(key).control_points.fill(value);
  }
  // Tiles of [0, side) x [0, side), all different.
  void Fill(int32_t side) {
    layer_->BeginCommit();
    for (int32_t n = 0; n < side * side; ++n) {
      layer_->EditTile({n % side, n / side})
          .control_points.fill(static_cast<ControlPoint>(1 + n % 20'000));
    }
  }
  // Touches all tiles and changes none.
  void CommitAgain() {
    const TileTree tiles = layer_->Snapshot().tiles;
    layer_->BeginCommit();
    tiles.ForEach([&](TileKey key, const TileTree::Entry&) { layer_->EditTile(key); });
  }

  void Step() {
    network_.Advance();
    digest_was_sent_ = false;
    if (!is_silent_) {
      CheckSession();
      publisher_->SetLayer(OwnersLayer(), network_.now());
      Speak();
    }
    for (const auto& follower : followers_) {
      const LayerFollower::Pulls pulls = follower->Tick(network_.now());
      for (const layer_pull_t& pull : pulls.nodes) Ask(pull, follower.get());
      if (pulls.scans) Ask(*pulls.scans, follower.get());
    }
  }
  void Run(milliseconds duration) {
    for (milliseconds passed(0); passed < duration; passed += kStep) Step();
  }

  bool AllCaughtUp() {
    for (size_t n = 0; n < followers_.size(); ++n) {
      if (!followers_[n]->caught_up() || !IsEqual(n)) return false;
    }
    return true;
  }
  // Bytes; and no tile claims to be of a later revision than the owner's.
  bool IsEqual(size_t n) {
    const LayerFollower::Subset& subset = subsets_[n];
    const LayerSnapshot mapped = layer_->Snapshot();
    const LayerSnapshot copy = followers_[n]->Snapshot();
    if (copy.session != mapped.session || copy.revision != mapped.revision) return false;
    LayerSnapshot owner = mapped;
    if (subset.level_of_detail.level > 0) {
      LayerPyramid levels(subset.level_of_detail.level);
      levels.Advance(mapped, 1'000'000);
      owner = levels.Layer(subset.level_of_detail);
    }
    bool is_equal = true;
    size_t num_tiles = 0;
    owner.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (subset.box && !subset.box->Contains(key)) return;
      ++num_tiles;
      const StoredTile* tile = copy.tiles.Find(key);
      is_equal = is_equal && tile != nullptr && HaveEqualContent(*tile, *entry.tile) &&
                 (subset.level_of_detail.level > 0 || copy.tiles.RevisionOf(key) <= entry.revision);
    });
    return is_equal && copy.tiles.size() == num_tiles;
  }

  // To all followers, in the name of the owner.
  void Forge(TileKey key, uint64_t revision, ControlPoint value) {
    Tile tile;
    tile.control_points.fill(value);
    const TileUpdate update = MakeTileUpdate(key, tile, revision);
    layer_updates_t updates;
    updates.layer = ToMessage(OwnersSession());
    updates.num_tiles = 1;
    updates.tiles.resize(1);
    tile_update_t& message = updates.tiles[0];
    message.tx = key.tx;
    message.ty = key.ty;
    message.revision = static_cast<int64_t>(revision);
    message.base_checksum = 0;
    message.checksum = static_cast<int64_t>(update.checksum);
    message.content.assign(update.content.begin(), update.content.end());
    message.num_bytes = static_cast<int32_t>(message.content.size());
    for (const auto& follower : followers_) follower->HandleUpdates(updates);
  }
  // A start of the owner that never was: without tiles, or with one of this hash that nobody has.
  void ForgeDigest(uint64_t session_number, int64_t hash = 0) {
    layer_digest_t digest = last_digest_;
    digest.layer.session_number = static_cast<int64_t>(session_number);
    digest.num_tiles = hash == 0 ? 0 : 1;
    digest.hash = hash;
    digest.revision = 0;
    for (const auto& follower : followers_) follower->HandleDigest(digest, network_.now());
  }

  // In the last step.
  bool DigestWasSent() const { return digest_was_sent_; }

  const layer_digest_t& last_digest() const { return last_digest_; }
  int64_t bytes_sent() const { return bytes_sent_; }
  int64_t bytes_of_owner() const { return bytes_of_owner_; }
  int64_t tiles_sent() const { return tiles_sent_; }
  int64_t scans_sent() const { return scans_sent_; }
  int64_t messages_sent() const { return messages_sent_; }  // by the owner

 private:
  void Speak() {
    budget_->Refill(network_.now(), publisher_->HasChanges(), publisher_->HasPulls());
    for (const ReplicationMessage& message : publisher_->Tick(network_.now(), *budget_)) {
      std::visit([&](const auto& m) { Broadcast(m); }, message);
    }
  }
  LayerRef OwnersSession() const { return {layer_->id(), layer_->session(), {}}; }
  void CheckSession() {
    const auto next = guard_.Next(OwnersSession(), network_.now(), random_());
    if (!next) return;
    ASSERT_FALSE(next->is_other_layer);
    layer_->StartSession(next->ref.id, next->ref.session);
    session_number_ = std::max(session_number_, next->ref.session.number);
    Publish();
  }
  void Publish() {
    publisher_ = std::make_shared<PyramidPublisher>(OwnersLayer(), kMapOptions, options_);
    budget_.emplace(options_.bytes_per_s);
  }
  void Broadcast(const layers_t&) {}  // nobody here sends any
  void Broadcast(const layer_updates_t& updates) {
    EXPECT_TRUE(updates.getEncodedSize() <= int(kMaxMessageBytes) || updates.num_tiles == 1);
    tiles_sent_ += updates.num_tiles;
    ToFollowers(updates, [updates](LayerFollower& f, auto) { f.HandleUpdates(updates); });
  }
  void Broadcast(const layer_digest_t& digest) {
    digest_was_sent_ = true;
    if (FromMessage(digest.layer).level_of_detail == LevelOfDetail()) last_digest_ = digest;
    ToFollowers(digest, [digest](LayerFollower& f, auto now) { f.HandleDigest(digest, now); });
  }
  void Broadcast(const layer_listing_t& listing) {
    ToFollowers(listing, [listing](LayerFollower& f, auto now) { f.HandleListing(listing, now); });
  }
  void Broadcast(const layer_scans_t& scans) {
    EXPECT_LE(scans.getEncodedSize(), int(kMaxMessageBytes));
    scans_sent_ += scans.num_scans;
    ToFollowers(scans, [scans](LayerFollower& f, auto now) { f.HandleScans(scans, now); });
  }
  void Broadcast(const layer_pull_t&) { ADD_FAILURE() << "owners do not pull"; }
  void Broadcast(const scan_pull_t&) { ADD_FAILURE() << "owners do not pull"; }
  void Broadcast(const settings_t&) { ADD_FAILURE() << "publishers know no settings"; }
  template <typename Message, typename Handle>
  void ToFollowers(const Message& message, Handle handle) {
    ++messages_sent_;
    bytes_sent_ += message.getEncodedSize();
    bytes_of_owner_ += message.getEncodedSize();
    for (const std::weak_ptr<LayerFollower> follower : followers_) {
      network_.Send([this, follower, handle] {
        if (const auto there = follower.lock()) handle(*there, network_.now());
      });
    }
  }
  template <typename Pull>
  void Ask(const Pull& pull, const LayerFollower* asker) {
    bytes_sent_ += pull.getEncodedSize();
    network_.Send([this, pull, owner = std::weak_ptr(publisher_)] {
      const auto there = owner.lock();
      if (!there) return;
      Tell(*there, pull);
      guard_.HandleKnown(FromMessage(pull.layer), OwnersSession(), network_.now());
    });
    for (const std::weak_ptr<LayerFollower> other : followers_) {
      if (other.lock().get() == asker) continue;
      network_.Send([this, pull, other] {
        if (const auto there = other.lock()) Tell(*there, pull);
      });
    }
  }
  void Tell(auto& owner_or_follower, const layer_pull_t& pull) {
    owner_or_follower.HandlePull(pull, network_.now());
  }
  void Tell(auto& owner_or_follower, const scan_pull_t& pull) {
    owner_or_follower.HandleScanPull(pull, network_.now());
  }
  Network network_;
  PublisherOptions options_;
  Commits commits_;
  Random random_;
  uint64_t session_number_ = 0;
  std::unique_ptr<MapWriter> map_;
  Layer* layer_ = nullptr;
  std::optional<ScanMapper> mapper_;
  std::shared_ptr<PyramidPublisher> publisher_;
  std::optional<ByteBudget> budget_;  // of it
  SessionGuard guard_;
  bool is_silent_ = false;
  std::vector<LayerFollower::Subset> subsets_;
  std::vector<std::shared_ptr<ScanFolder>> folders_;  // of the followers
  std::vector<std::shared_ptr<LayerFollower>> followers_;
  bool digest_was_sent_ = false;
  layer_digest_t last_digest_;
  int64_t bytes_sent_ = 0;
  int64_t bytes_of_owner_ = 0;
  int64_t tiles_sent_ = 0;
  int64_t scans_sent_ = 0;
  int64_t messages_sent_ = 0;
};

}  // namespace splinemap::replication_test
