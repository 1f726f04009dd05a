#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <set>
#include <thread>

#include "lib/base/status.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/layer_block.h"
#include "lib/fleet/layer_digest.h"
#include "lib/fleet/layer_upload.h"
#include "lib/fleet/sum_block.h"
#include "lib/fleet/sum_upload.h"
#include "lib/fleet/work_sharing.h"
#include "lib/store/settings_record.h"
#include "splinemap/layer_set.h"
#include "tests/support/map_writer.h"
#include "tests/support/memory_fleet_store.h"
#include "tests/support/random_map.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

std::set<uint64_t> RandomWorkers(std::mt19937_64& random, size_t size) {
  std::set<uint64_t> workers;
  while (workers.size() < size) workers.insert(random());
  return workers;
}

TEST(WorkSharingTest, EachPartHasTwoOwnersAndWorkersHaveLikeShares) {
  std::mt19937_64 random(1);
  const std::set<uint64_t> workers = RandomWorkers(random, 8);
  std::map<uint64_t, int> parts;
  for (int part = 0; part < kParts; ++part) {
    const std::vector<uint64_t> owners = OwnersOf(part, workers);
    ASSERT_EQ(owners.size(), 2u);
    EXPECT_NE(owners[0], owners[1]);
    for (const uint64_t owner : owners) ++parts[owner];
  }
  EXPECT_EQ(parts.size(), 8u);
  for (const auto& [worker, count] : parts) EXPECT_LE(count, 32);  // 16 in the mean
  EXPECT_EQ(OwnersOf(0, {7}), std::vector<uint64_t>{7});
}

TEST(WorkSharingTest, OnlyThePartsOfWhoComesOrGoesMove) {
  std::mt19937_64 random(2);
  for (int round = 0; round < 20; ++round) {
    const std::set<uint64_t> before = RandomWorkers(random, 5);
    const uint64_t gone = *std::next(before.begin(), static_cast<int>(random() % 5));
    std::set<uint64_t> after = before;
    after.erase(gone);
    for (int part = 0; part < kParts; ++part) {
      std::vector<uint64_t> stayed = OwnersOf(part, before);
      std::erase(stayed, gone);
      const std::vector<uint64_t> owners = OwnersOf(part, after);
      for (const uint64_t owner : stayed) {
        EXPECT_NE(std::find(owners.begin(), owners.end(), owner), owners.end());
      }
      if (stayed.size() == kOwners) {
        EXPECT_EQ(owners, stayed);
      }
    }
  }
}

TEST(WorkSharingTest, WordsAreReadAsWrittenAndNothingElseIs) {
  const WorkerWord word{0x123456789abcdef0, PartSet(0xfedcba9876543210)};
  const std::string text = EncodeWord(word);
  const auto read = DecodeWord(text);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->worker, word.worker);
  EXPECT_EQ(read->complete, word.complete);
  for (const std::string& other : {std::string(), text + "0", text.substr(1), "-" + text.substr(1),
                                   "g" + text.substr(1), std::string(33, ' ')}) {
    EXPECT_FALSE(DecodeWord(other)) << other;
  }
}

TEST(WorkShareTest, APartIsAnsweredUntilAnOwnerHasItAndTwoSecondsMore) {
  Clock::time_point now{std::chrono::hours(1)};
  WorkShare share(1);
  share.Update(now);
  EXPECT_TRUE(share.owned().all());  // alone
  EXPECT_TRUE(share.published().all());
  // Two others come, and have nothing yet.
  PartSet lost;
  const auto tell = [&](const PartSet& complete) {
    share.Hear({2, complete}, now);
    share.Hear({3, complete}, now);
    share.Update(now);
  };
  tell({});
  lost = ~share.owned();
  ASSERT_TRUE(lost.any());
  EXPECT_EQ(share.workers(), 3u);
  for (int k = 0; k < 20; ++k) {
    now += milliseconds(1000);
    tell({});
    EXPECT_TRUE(share.answered().all());
  }
  // They have them.
  now += milliseconds(1000);
  tell(PartSet().set());
  EXPECT_TRUE(share.answered().all());
  now += milliseconds(1400);
  tell(PartSet().set());
  EXPECT_EQ(share.answered(), ~lost);
  EXPECT_TRUE(share.followed().all());  // a moment more
  now += milliseconds(1000);
  tell(PartSet().set());
  EXPECT_EQ(share.followed(), ~lost);
  // They are heard no more.
  now += milliseconds(3600);
  share.Update(now);
  EXPECT_TRUE(share.owned().all());
  EXPECT_EQ(share.workers(), 1u);
}

// A bucket with the layers of a random map over several squares.
class FleetPartsTest : public testing::Test {
 protected:
  FleetPartsTest() {
    for (const char* const name : {"robot-1", "robot-2"}) Change(map_.AddLayer({name, 1}, {1, 1}));
    store_.Write({kMapKey, EncodeMapOptions(map_.options()), 1});
    Upload();
  }

  void Change(Layer& layer) {
    layer.BeginCommit();
    for (int k = 0; k < 40; ++k) {
      const TileKey near = RandomKey(random_, 50);
      layer.EditTile(near) = RandomTile(random_, map_.options().limits);
    }
  }
  void Upload() {
    for (const LayerSnapshot& layer : map_.Layers().layers) {
      LayerUpload upload(store_, layer.id, map_.options());
      ASSERT_TRUE(upload.Bring(layer, [](int64_t) { return true; }).ok());
    }
  }
  template <typename Condition>
  static bool Wait(Condition is_met) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (!is_met() && std::chrono::steady_clock::now() < end) {
      std::this_thread::sleep_for(milliseconds(10));
    }
    return is_met();
  }
  // Tiles of a view in some parts.
  static std::map<TileKey, uint64_t> ChecksumsIn(const MapView& view, const std::set<int>& parts) {
    std::map<TileKey, uint64_t> checksums;
    view.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (parts.contains(PartOf(key))) checksums[key] = entry.tile->Checksum(key);
    });
    return checksums;
  }
  // What the bucket of sums has.
  std::map<TileKey, uint64_t> StoredSum() {
    std::map<TileKey, uint64_t> checksums;
    EXPECT_TRUE(sums_
                    .List("sum.>", true,
                          [&](const FleetEntry& entry) {
                            const auto key = ParseSumKey(entry.key);
                            ASSERT_TRUE(key);
                            const auto block =
                                DecodeBlock(entry.value, *key, nullptr, map_.options().limits);
                            ASSERT_TRUE(block.ok());
                            for (int child = 0; child < 16; ++child) {
                              const auto& tile = block->tiles[child].tile;
                              const TileKey at = key->Tile(child);
                              if (tile) checksums[at] = tile->Checksum(at);
                            }
                          })
                    .ok());
    return checksums;
  }

  std::mt19937_64 random_{5};
  MapWriter map_{{0.05, {-2560, 2560}}};
  MemoryFleetStore store_;
  MemoryFleetStore sums_;
};

FleetFollowOptions OfParts(std::set<int> parts) {
  FleetFollowOptions options;
  options.parts = std::move(parts);
  return options;
}

TEST_F(FleetPartsTest, AReplicaFollowsOtherPartsWhenItIsTold) {
  FleetReplica replica(store_, OfParts({0}));
  std::set<int> all;
  for (int part = 0; part < kParts; ++part) all.insert(part);
  for (const std::set<int>& parts : {std::set<int>{0}, std::set<int>{0, 1, 8, 9, 63},
                                     std::set<int>{9, 63}, std::set<int>{}, std::set<int>{0, 9}}) {
    replica.SetParts(parts);
    ASSERT_TRUE(Wait([&] { return replica.CompleteParts() == parts; }));
    const auto expected = ChecksumsIn(*map_.View(), parts);
    // All of the parts, and soon nothing else.
    EXPECT_EQ(ChecksumsIn(*replica.View(), parts), expected);
    EXPECT_TRUE(Wait([&] { return ChecksumsIn(*replica.View(), all) == expected; }));
  }
  Change(map_.layer(0));
  Upload();
  const auto expected = ChecksumsIn(*map_.View(), {0, 9});
  EXPECT_TRUE(Wait([&] { return ChecksumsIn(*replica.View(), all) == expected; }));
}

TEST_F(FleetPartsTest, APlacedLayerIsFollowedAsAWhole) {
  SettingsTable settings;
  LayerSettings placed;
  placed.counter = 1;
  placed.placement = FixedPose2::Nearest({{40, -30}, 0.5});
  settings.Merge({"robot-1", 1}, placed);
  map_.SetSettings(settings);
  store_.Write({SettingsKey({"robot-1", 1}), EncodeSettings({"robot-1", 1}, placed), 1});
  FleetReplica replica(store_, OfParts({0, 9}));
  const auto expected = ChecksumsIn(*map_.View(), {0, 9});
  EXPECT_FALSE(expected.empty());
  EXPECT_TRUE(Wait([&] {
    return replica.CompleteParts() == std::set<int>{0, 9} &&
           ChecksumsIn(*replica.View(), {0, 9}) == expected;
  }));
}

TEST_F(FleetPartsTest, TheSumOfPartsIsPublishedAndMendedByHash) {
  SumUpload upload(sums_);
  const std::set<int> parts{0, 1, 7, 56, 63};
  PartSet bits;
  for (const int part : parts) bits.set(static_cast<size_t>(part));
  ASSERT_TRUE(upload.Bring(*map_.View(), bits).ok());
  EXPECT_EQ(StoredSum(), ChecksumsIn(*map_.View(), parts));
  const int64_t written = upload.blocks();
  EXPECT_GT(written, 0);
  // Nothing new, nothing written; also by another worker that takes over.
  ASSERT_TRUE(upload.Bring(*map_.View(), bits).ok());
  EXPECT_EQ(upload.blocks(), written);
  SumUpload other(sums_);
  ASSERT_TRUE(other.Bring(*map_.View(), bits).ok());
  EXPECT_EQ(other.blocks(), 0);
  // Changes.
  const MemoryFleetStore::Backup old = sums_.Save();
  Change(map_.layer(1));
  ASSERT_TRUE(upload.Bring(*map_.View(), bits).ok());
  EXPECT_EQ(StoredSum(), ChecksumsIn(*map_.View(), parts));
  // A layer is gone, and tiles with it.
  LayerSet one = map_.Layers();
  one.layers.pop_back();
  const auto less = ViewOf(one);
  ASSERT_LT(ChecksumsIn(*less, parts).size(), ChecksumsIn(*map_.View(), parts).size());
  ASSERT_TRUE(upload.Bring(*less, bits).ok());
  EXPECT_EQ(StoredSum(), ChecksumsIn(*less, parts));
  // An old bucket, and an empty one, become right when the connection is made anew.
  for (const MemoryFleetStore::Backup& backup : {old, MemoryFleetStore::Backup()}) {
    sums_.GoAway();
    sums_.Restore(backup);
    sums_.ComeBack();
    ASSERT_TRUE(upload.Bring(*map_.View(), bits).ok());
    EXPECT_EQ(StoredSum(), ChecksumsIn(*map_.View(), parts));
  }
  // Parts that are others' now stay as they are.
  ASSERT_TRUE(upload.Bring(*less, PartSet(1)).ok());
  std::set<int> rest = parts;
  rest.erase(0);
  const auto in_rest = ChecksumsIn(*map_.View(), rest);
  auto expected = ChecksumsIn(*less, {0});
  expected.insert(in_rest.begin(), in_rest.end());
  EXPECT_EQ(StoredSum(), expected);
}

TEST_F(FleetPartsTest, ASumWhoseAcknowledgementsGetLostIsRightInTheEnd) {
  SumUpload upload(sums_);
  sums_.FailAfterWrites(3);
  EXPECT_FALSE(upload.Bring(*map_.View(), PartSet().set()).ok());
  ASSERT_TRUE(upload.Bring(*map_.View(), PartSet().set()).ok());
  std::set<int> all;
  for (int part = 0; part < kParts; ++part) all.insert(part);
  EXPECT_EQ(StoredSum(), ChecksumsIn(*map_.View(), all));
}

}  // namespace
}  // namespace splinemap
