#include "lib/fleet/layer_upload.h"

#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <vector>

#include "lib/fleet/fleet_follower.h"
#include "lib/fleet/layer_digest.h"
#include "lib/map/map_changes.h"
#include "lib/store/settings_record.h"
#include "splinemap/map_view.h"
#include "tests/support/memory_fleet_store.h"
#include "tests/support/num_schedules.h"
#include "tests/support/random_map.h"

namespace splinemap::layer_upload_test {

const MapOptions kMapOptions{0.05, {-2560, 2560}};
const LayerId kId{"robot", 7};
constexpr auto kUnpaced = [](int64_t) { return true; };

void Commit(Layer& layer, std::mt19937_64& random, int extent = 12) {
  layer.BeginCommit();
  for (int k = 0; k < 5; ++k) {
    layer.EditTile(RandomKey(random, extent)) = RandomTile(random, kMapOptions.limits);
  }
}

void ExpectEqual(const TileTree& a, const TileTree& b) {
  size_t tiles = 0;
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const auto other = FindTile(b, key);
    ASSERT_NE(other, nullptr);
    EXPECT_EQ(*entry.tile->Get(), *other);
    ++tiles;
  });
  EXPECT_EQ(b.size(), tiles);
}

// A copy that compares and hears of changes, as FleetReplica has one in a thread.
class Copy {
 public:
  Copy(FleetStore& store, FleetFollowOptions options)
      : store_(store), follower_(std::move(options)) {}

  void Compare() {
    for (const std::string& filter : follower_.Filters()) {
      if (!subscriptions_.contains(filter)) {
        auto subscription = store_.Subscribe(
            filter, [this](FleetEntry entry) { inbox_.push_back(std::move(entry)); });
        if (!subscription.ok()) return;
        subscriptions_[filter] = *std::move(subscription);
      }
      std::vector<FleetEntry> entries;
      const auto listed = store_.List(
          filter, false, [&](FleetEntry entry) { entries.push_back(std::move(entry)); });
      if (!listed.ok()) return;
      for (const std::string& key : follower_.HandleList(filter, entries, Clock::now())) {
        const auto entry = store_.Get(key);
        if (entry.ok()) follower_.Handle(*entry, Clock::now());
        if (absl::IsOutOfRange(entry.status())) follower_.HandleGone(key, Clock::now());
      }
    }
  }
  void Drain() {
    for (const FleetEntry& entry : std::exchange(inbox_, {})) {
      follower_.Handle(entry, Clock::now());
    }
  }
  FleetFollower& follower() { return follower_; }

 private:
  FleetStore& store_;
  FleetFollower follower_;
  std::vector<FleetEntry> inbox_;
  std::map<std::string, std::unique_ptr<FleetSubscription>> subscriptions_;
};

class LayerUploadTest : public testing::Test {
 protected:
  LayerUploadTest() { store_.Write({kMapKey, EncodeMapOptions(kMapOptions), 1}); }

  LayerSnapshot CommitAndBring(int commits = 1) {
    for (int k = 0; k < commits; ++k) Commit(layer_, random_);
    const LayerSnapshot snapshot = layer_.Snapshot();
    EXPECT_TRUE(upload_.Bring(snapshot, kUnpaced).ok());
    return snapshot;
  }
  // What the bucket holds for whoever comes now.
  LayerSet Stored(FleetFollowOptions options = {}) {
    Copy copy(store_, std::move(options));
    for (int k = 0; k < 2; ++k) copy.Compare();  // of the layers that the first has found
    EXPECT_TRUE(copy.follower().IsWhole());
    EXPECT_TRUE(copy.follower().Refused().empty());
    return copy.follower().Layers();
  }
  void ExpectStored(const LayerSnapshot& layer) {
    const LayerSet set = Stored();
    const LayerSnapshot* stored = set.Find(layer.id);
    ASSERT_NE(stored, nullptr);
    EXPECT_EQ(stored->session, layer.session);
    EXPECT_EQ(stored->revision, layer.revision);
    ExpectEqual(stored->tiles, layer.tiles);
  }
  std::vector<std::string> KeysOf(const std::string& filter) {
    std::vector<std::string> keys;
    EXPECT_TRUE(store_
                    .List(filter, true,
                          [&](const FleetEntry& entry) {
                            if (!entry.value.empty()) keys.push_back(entry.key);
                          })
                    .ok());
    return keys;
  }

  std::mt19937_64 random_{1};
  MemoryFleetStore store_;
  Layer layer_{kId, {3, 99}};
  LayerUpload upload_{store_, kId, kMapOptions};
};

TEST_F(LayerUploadTest, WhatIsBroughtIsStoredByteForByte) { ExpectStored(CommitAndBring(20)); }

TEST_F(LayerUploadTest, OnlyBlocksThatDifferAreWritten) {
  CommitAndBring(20);
  const int64_t before = store_.writes();
  layer_.BeginCommit();
  layer_.EditTile({3, -5}).control_points[17] ^= 1;
  ASSERT_TRUE(upload_.Bring(layer_.Snapshot(), kUnpaced).ok());
  EXPECT_EQ(store_.writes(), before + 2);  // its block, and the digest
  // Another program of the same robot, that knows nothing.
  LayerUpload other(store_, kId, kMapOptions);
  ASSERT_TRUE(other.Bring(layer_.Snapshot(), kUnpaced).ok());
  EXPECT_EQ(store_.writes(), before + 2);
  ExpectStored(layer_.Snapshot());
}

TEST_F(LayerUploadTest, NothingIsListedWhereTheLastDigestSaysIt) {
  CommitAndBring(20);
  EXPECT_EQ(store_.lists(), 0);  // there was nothing
  store_.GoAway();
  EXPECT_FALSE(upload_.Look().ok());
  store_.ComeBack();
  CommitAndBring();
  EXPECT_EQ(store_.lists(), 0);
  LayerUpload restarted(store_, kId, kMapOptions);
  ASSERT_TRUE(restarted.Bring(layer_.Snapshot(), kUnpaced).ok());
  EXPECT_EQ(store_.lists(), 0);
  // A block that was stored after the digest, of which nobody was told.
  store_.FailAfterWrites(0);
  Commit(layer_, random_);
  EXPECT_FALSE(upload_.Bring(layer_.Snapshot(), kUnpaced).ok());
  store_.FailAfterWrites(-1);
  ASSERT_TRUE(upload_.Bring(layer_.Snapshot(), kUnpaced).ok());
  EXPECT_EQ(store_.lists(), 1);
  ExpectStored(layer_.Snapshot());
}

TEST_F(LayerUploadTest, ASessionThatBeginsEmptyTakesTheTilesAway) {
  CommitAndBring(20);
  layer_.StartEmptySession({4, 100});
  layer_.EditTile({40, 40}) = RandomTile(random_, kMapOptions.limits);
  ASSERT_TRUE(upload_.Bring(layer_.Snapshot(), kUnpaced).ok());
  ExpectStored(layer_.Snapshot());
  EXPECT_EQ(KeysOf("layers.*.*.tiles.>").size(), 1u);
}

TEST_F(LayerUploadTest, ALostAcknowledgementIsMended) {
  for (int writes = 0; writes < 12; ++writes) {
    Commit(layer_, random_);
    store_.FailAfterWrites(writes % 4);
    const LayerSnapshot snapshot = layer_.Snapshot();
    if (!upload_.Bring(snapshot, kUnpaced).ok()) {
      ASSERT_TRUE(upload_.Bring(snapshot, kUnpaced).ok());
    }
    store_.FailAfterWrites(-1);
    ExpectStored(snapshot);
  }
}

TEST_F(LayerUploadTest, WhatTheEngineForgotIsFoundAndWrittenAgain) {
  const LayerSnapshot early = CommitAndBring(5);
  const MemoryFleetStore::Backup backup = store_.Save();
  const LayerSnapshot late = CommitAndBring(5);
  store_.Restore(backup);
  ExpectStored(early);
  ASSERT_TRUE(upload_.Look().ok());
  ASSERT_TRUE(upload_.Bring(late, kUnpaced).ok());
  ExpectStored(late);
  store_.Restore({});
  ASSERT_TRUE(upload_.Look().ok());
  ASSERT_TRUE(upload_.Bring(late, kUnpaced).ok());
  store_.Write({kMapKey, EncodeMapOptions(kMapOptions), 1});
  ExpectStored(late);
}

TEST_F(LayerUploadTest, WhatOthersWroteOverItIsMended) {
  const LayerSnapshot layer = CommitAndBring(10);
  const std::string key = KeysOf("layers.*.*.tiles.>").front();
  store_.Write({key, "nonsense", 12345});
  Copy copy(store_, {});
  copy.Compare();
  EXPECT_FALSE(copy.follower().IsWhole());
  ASSERT_EQ(copy.follower().Refused().size(), 1u);
  upload_.CompareAgain();
  ASSERT_TRUE(upload_.Bring(layer, kUnpaced).ok());
  copy.Drain();
  EXPECT_TRUE(copy.follower().IsWhole());
  ExpectStored(layer);
}

TEST_F(LayerUploadTest, ABlockOfAnotherLayerIsNotTaken) {
  CommitAndBring(10);
  std::mt19937_64 random(5);
  Layer victim(LayerId{"victim", 1}, SessionId{1, 1});
  Commit(victim, random);
  LayerUpload upload(store_, victim.id(), kMapOptions);
  ASSERT_TRUE(upload.Bring(victim.Snapshot(), kUnpaced).ok());
  Copy copy(store_, {});
  copy.Compare();
  // A true block of the robot, under the key of the same block of the victim.
  for (const std::string& key : KeysOf("layers.robot.*.tiles.>")) {
    FleetEntry entry = *store_.Get(key);
    entry.key = BlockKeyOf(victim.id(), ParseFleetKey(key).block);
    store_.Write(entry);
  }
  copy.Drain();
  ExpectEqual(copy.follower().Layers().Find(victim.id())->tiles, victim.tiles());
}

TEST_F(LayerUploadTest, ABlockThatLacksATileIsNotTaken) {
  const LayerSnapshot layer = CommitAndBring(10);
  Copy copy(store_, {});
  copy.Compare();
  for (const std::string& key : KeysOf("layers.*.*.tiles.>")) {
    FleetEntry entry = *store_.Get(key);
    const BlockKey at = ParseFleetKey(key).block;
    LayerBlock block = *DecodeBlock(entry.value, at, &kId, kMapOptions.limits);
    for (LayerBlock::Entry& tile : block.tiles) {
      if (std::exchange(tile, {}).tile) break;
    }
    if (block.IsEmpty()) continue;
    entry.value = *EncodeBlock(block, at, &kId);
    store_.Write(entry);
  }
  copy.Drain();
  EXPECT_GT(copy.follower().malformed(), 0);
  ExpectEqual(copy.follower().Layers().Find(kId)->tiles, layer.tiles);
}

TEST_F(LayerUploadTest, AGreaterSessionIsNotOverwritten) {
  CommitAndBring();
  Layer older(kId, {2, 50});
  Commit(older, random_);
  LayerUpload upload(store_, kId, kMapOptions);
  EXPECT_TRUE(absl::IsFailedPrecondition(upload.Bring(older.Snapshot(), kUnpaced)));
  EXPECT_EQ(upload.greater_session(), (SessionId{3, 99}));
  ExpectStored(layer_.Snapshot());
}

TEST_F(LayerUploadTest, ALaterSessionOfAnOlderFileTakesTheNewerTilesAway) {
  const LayerSnapshot old_file = CommitAndBring(3);
  CommitAndBring(20);
  LayerUpload upload(store_, kId, kMapOptions);
  Layer older(old_file, {2, 50});
  EXPECT_TRUE(absl::IsFailedPrecondition(upload.Bring(older.Snapshot(), kUnpaced)));
  older.StartSession(kId, {4, 50});
  ASSERT_TRUE(upload.Bring(older.Snapshot(), kUnpaced).ok());
  ExpectStored(older.Snapshot());
}

TEST_F(LayerUploadTest, WhatIsForgottenWhileItIsBroughtIsWrittenAgain) {
  const LayerSnapshot early = CommitAndBring(3);
  const MemoryFleetStore::Backup backup = store_.Save();
  for (int k = 0; k < 30; ++k) Commit(layer_, random_, 60);
  const LayerSnapshot late = layer_.Snapshot();
  int batches = 0;
  const auto go_back_once = [&](int64_t) {
    if (++batches == 3) {
      store_.Restore(backup);
      store_.GoAway();
      store_.ComeBack();
    }
    return true;
  };
  EXPECT_FALSE(upload_.Bring(late, go_back_once).ok());
  ASSERT_TRUE(upload_.Bring(late, kUnpaced).ok());
  ExpectStored(late);
}

TEST_F(LayerUploadTest, WhatALesserSessionWroteOverItShows) {
  const LayerSnapshot layer = CommitAndBring(10);
  // It has found nothing later, and writes before it sees that its digest is refused.
  FleetEntry stray = *store_.Get(KeysOf("layers.*.*.tiles.>").front());
  stray.value = "of a lesser session";
  store_.Write(stray);
  ASSERT_TRUE(upload_.Look().ok());
  ASSERT_TRUE(upload_.Bring(layer, kUnpaced).ok());
  // Its hash is the one that belongs there.
  EXPECT_EQ(upload_.counts().listed, 1);
}

TEST_F(LayerUploadTest, ALayerThatIsOnItsWayIsShownAndNotWhole) {
  for (int k = 0; k < 100; ++k) Commit(layer_, random_, 60);
  int batches = 0;
  EXPECT_FALSE(upload_.Bring(layer_.Snapshot(), [&](int64_t) { return ++batches < 5; }).ok());
  Copy copy(store_, {});
  copy.Compare();
  ASSERT_EQ(copy.follower().Layers().layers.size(), 1u);
  EXPECT_GT(copy.follower().Layers().layers[0].tiles.size(), 0u);
  EXPECT_FALSE(copy.follower().IsWhole());
  // Whoever brings it then does not take it for whole.
  LayerUpload restarted(store_, kId, kMapOptions);
  ASSERT_TRUE(restarted.Bring(layer_.Snapshot(), kUnpaced).ok());
  ExpectStored(layer_.Snapshot());
}

TEST_F(LayerUploadTest, AnUploadThatIsEndedGoesOnWhereItWas) {
  for (int k = 0; k < 200; ++k) Commit(layer_, random_, 60);
  const LayerSnapshot layer = layer_.Snapshot();
  int batches = 0;
  EXPECT_TRUE(absl::IsCancelled(upload_.Bring(layer, [&](int64_t) { return ++batches < 3; })));
  const int64_t before = upload_.counts().blocks;
  EXPECT_GT(before, 0);
  ASSERT_TRUE(upload_.Bring(layer, kUnpaced).ok());
  EXPECT_EQ(upload_.counts().blocks, static_cast<int64_t>(KeysOf("layers.*.*.tiles.>").size()));
  ExpectStored(layer);
}

TEST_F(LayerUploadTest, LayersBesideARegionAreNotFollowed) {
  CommitAndBring(10);  // within 12 tiles, 20 m
  std::mt19937_64 random(5);
  Layer far(LayerId{"far", 1}, SessionId{1, 1});
  far.BeginCommit();
  far.EditTile({1000, 0}) = RandomTile(random, kMapOptions.limits);
  LayerUpload upload(store_, far.id(), kMapOptions);
  ASSERT_TRUE(upload.Bring(far.Snapshot(), kUnpaced).ok());
  EXPECT_EQ(Stored().layers.size(), 2u);
  FleetFollowOptions options;
  options.region = Region{1599, 0, 1610, 5};
  const LayerSet set = Stored(options);
  ASSERT_EQ(set.layers.size(), 1u);
  EXPECT_EQ(set.layers[0].id, far.id());
  ExpectEqual(set.layers[0].tiles, far.tiles());
}

TEST_F(LayerUploadTest, LayersOfOtherKnotsAreRefusedWithBothValues) {
  Layer other(LayerId{"coarse", 1}, SessionId{1, 1});
  Commit(other, random_);
  LayerUpload upload(store_, other.id(), {0.1, kMapOptions.limits});
  ASSERT_TRUE(upload.Bring(other.Snapshot(), kUnpaced).ok());
  Copy copy(store_, {});
  copy.Compare();
  EXPECT_TRUE(copy.follower().Layers().layers.empty());
  ASSERT_EQ(copy.follower().Refused().size(), 1u);
  EXPECT_NE(copy.follower().Refused()[0].find("0.1 m"), std::string::npos);
  EXPECT_NE(copy.follower().Refused()[0].find("0.05 m"), std::string::npos);
}

TEST_F(LayerUploadTest, ARemovedLayerIsLeftOut) {
  CommitAndBring();
  SettingsTable settings;
  const LayerSettings removal = settings.Removal(kId, layer_.session(), 1);
  store_.Write({SettingsKey(kId), EncodeSettings(kId, removal), 1});
  EXPECT_TRUE(Stored().layers.empty());
}

// Robots that map, are away, and come back as others; a store that forgets, goes back to a backup,
// goes away, loses acknowledgements and tells nobody of changes; copies that hear of some.
TEST(FleetLawTest, InTheEndTheStoreAndAllCopiesHaveTheLayersOfAllRobots) {
  for (int seed = 1; seed <= NumSchedules(30); ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    std::mt19937_64 random(static_cast<uint64_t>(seed));
    MemoryFleetStore store;
    store.Write({kMapKey, EncodeMapOptions(kMapOptions), 1});
    struct Robot {
      Layer layer;
      std::unique_ptr<LayerUpload> upload;
    };
    std::vector<Robot> robots;
    for (uint64_t k = 0; k < 3; ++k) {
      Robot robot{Layer(LayerId{"robot." + std::to_string(k), k}, SessionId{1, k}), nullptr};
      robot.upload = std::make_unique<LayerUpload>(store, robot.layer.id(), kMapOptions);
      robots.push_back(std::move(robot));
    }
    Copy copy(store, {});
    MemoryFleetStore::Backup backup;
    for (int step = 0; step < 150; ++step) {
      Robot& robot = robots[random() % robots.size()];
      switch (random() % 16) {
        case 0: {
          const SessionId next{robot.layer.session().number + 1, random()};
          if (random() % 3 == 0) {
            robot.layer.StartEmptySession(next);
          } else {
            robot.layer.StartSession(robot.layer.id(), next);
          }
          break;
        }
        case 1:
          store.GoAway();
          break;
        case 2:
          store.Restore(random() % 2 == 0 ? MemoryFleetStore::Backup() : backup);
          break;
        case 3:
          backup = store.Save();
          break;
        case 4:
          store.SetSilent(random() % 2 == 0);
          break;
        case 5:
          store.FailAfterWrites(static_cast<int>(random() % 5));
          break;
        case 6:
          robot.upload = std::make_unique<LayerUpload>(store, robot.layer.id(), kMapOptions);
          break;
        case 7:
          copy.Compare();
          break;
        case 8:
          copy.Drain();
          break;
        case 9:
          store.ComeBack();
          break;
        case 10: {
          // Whoever can write junk there.
          store.Write({BlockKeyOf(robot.layer.id(), {0, 0}), "junk", random()});
          break;
        }
        default:
          Commit(robot.layer, random);
          static_cast<void>(robot.upload->Bring(robot.layer.Snapshot(),
                                                [&](int64_t) { return random() % 4 != 0; }));
      }
    }
    store.ComeBack();
    store.SetSilent(false);
    store.FailAfterWrites(-1);
    store.Write({kMapKey, EncodeMapOptions(kMapOptions), 1});
    for (Robot& robot : robots) {
      // What somebody wrote before the last digest shows now and then alone.
      robot.upload->CompareAgain();
      ASSERT_TRUE(robot.upload->Bring(robot.layer.Snapshot(), kUnpaced).ok());
    }
    Copy late(store, {});
    for (Copy* each : {&copy, &late}) {
      each->Drain();
      each->Compare();
      each->Drain();
      ASSERT_TRUE(each->follower().IsWhole());
      LayerSet sources{.options = kMapOptions};
      for (Robot& robot : robots) sources.layers.push_back(robot.layer.Snapshot());
      const LayerSet copied = each->follower().Layers();
      ASSERT_EQ(copied.layers.size(), robots.size());
      for (const LayerSnapshot& source : sources.layers) {
        const LayerSnapshot* layer = copied.Find(source.id);
        ASSERT_NE(layer, nullptr);
        EXPECT_EQ(layer->session, source.session);
        ExpectEqual(layer->tiles, source.tiles);
      }
      ExpectEqual(ViewOf(copied)->tiles, ViewOf(sources)->tiles);
    }
  }
}

TEST(FleetKeyTest, EveryNameHasOneToken) {
  const std::string all = "robot-1_A.b *>\n=\xc3\xa4";
  EXPECT_EQ(TokenOf(all), "robot-1_A=2eb=20=2a=3e=0a=3d=c3=a4");
  EXPECT_EQ(NameOfToken(TokenOf(all)), all);
  for (const char* const token : {"=", "=4", "=41", "=zz", "a=2", "a b", "=2E"}) {
    EXPECT_EQ(NameOfToken(token), "") << token;
  }
}

TEST(FleetKeyTest, KeysAreReadAsTheyAreWritten) {
  const LayerId id{"a.b", 0xfedcba9876543210};
  for (const BlockKey block : {BlockKey{0, 0}, {-1, -1}, {7, -8}, {-1000, 12345}}) {
    const FleetKey key = ParseFleetKey(BlockKeyOf(id, block));
    EXPECT_EQ(key.kind, FleetKey::Kind::kBlock);
    EXPECT_EQ(key.layer, id);
    EXPECT_EQ(key.block, block);
    EXPECT_TRUE(MatchesFilter(PartFilter(PartOf(block)), BlockKeyOf(id, block)));
    EXPECT_TRUE(MatchesFilter(TilesFilter(id), BlockKeyOf(id, block)));
  }
  EXPECT_EQ(ParseFleetKey(DigestKey(id)).kind, FleetKey::Kind::kDigest);
  EXPECT_EQ(ParseFleetKey(SettingsKey(id)).kind, FleetKey::Kind::kSettings);
  for (const char* const key :
       {"", "mapp", "layers", "layers.a.0.digest", "layers..0000000000000001.digest",
        "layers.a.0000000000000001.tiles.01.0.0", "layers.a.0000000000000001.tiles.00.00.0",
        "layers.a.0000000000000001.tiles.00.0.99999999999", "layers.a.-1.digest"}) {
    EXPECT_EQ(ParseFleetKey(key).kind, FleetKey::Kind::kOther) << key;
  }
  EXPECT_FALSE(MatchesFilter("a.*", "a.b.c"));
  EXPECT_FALSE(MatchesFilter("a.b.>", "a.b"));
  EXPECT_TRUE(MatchesFilter("a.>", "a.b.c"));
}

TEST(FleetKeyTest, ASquareIsOfOnePartAndItsNeighboursAreOfOthers) {
  EXPECT_EQ(PartOf(TileKey{0, 0}), PartOf(TileKey{31, 31}));
  EXPECT_NE(PartOf(TileKey{0, 0}), PartOf(TileKey{32, 0}));
  EXPECT_NE(PartOf(TileKey{0, 0}), PartOf(TileKey{-1, 0}));
  EXPECT_NE(PartOf(TileKey{0, 0}), PartOf(TileKey{0, -1}));
  for (int t = -300; t < 300; ++t) {
    EXPECT_GE(PartOf(TileKey{t, -t}), 0);
    EXPECT_LT(PartOf(TileKey{t, -t}), kParts);
  }
}

TEST(LayerBlockTest, BytesThatCannotBeAreRefused) {
  std::mt19937_64 random(3);
  Layer layer(kId, {1, 1});
  layer.BeginCommit();
  layer.EditTile({-3, 5}) = RandomTile(random, kMapOptions.limits);
  layer.EditTile({-1, 6}) = RandomTile(random, kMapOptions.limits);
  const BlockKey key = BlockKey::Of({-3, 5});
  const LayerBlock block = BlockOf(layer.tiles(), key);
  const std::string value = *EncodeBlock(block, key, &kId);
  const absl::StatusOr<LayerBlock> again = DecodeBlock(value, key, &kId, kMapOptions.limits);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(HashOf(*again, key), HashOf(block, key));
  EXPECT_EQ(again->SumOf(key), block.SumOf(key));
  const LayerId other{"robot", 8};
  EXPECT_FALSE(DecodeBlock(value, key, &other, kMapOptions.limits).ok());
  EXPECT_FALSE(DecodeBlock(value, key, nullptr, kMapOptions.limits).ok());
  EXPECT_FALSE(DecodeBlock(value, {key.x, key.y + 1}, &kId, kMapOptions.limits).ok());
  EXPECT_FALSE(DecodeBlock(value, key, &kId, {-1, 1}).ok());
  for (size_t k = 0; k < value.size(); ++k) {
    std::string damaged = value;
    damaged[k] = static_cast<char>(damaged[k] ^ (1 << random() % 8));
    const absl::StatusOr<LayerBlock> read = DecodeBlock(damaged, key, &kId, kMapOptions.limits);
    // Tiles have checksums. What a record lacks shows by the hash of the entry.
    if (!read.ok()) continue;
    for (size_t child = 0; child < read->tiles.size(); ++child) {
      if (!read->tiles[child].tile) continue;
      ASSERT_NE(block.tiles[child].tile, nullptr);
      EXPECT_EQ(*read->tiles[child].tile->Get(), *block.tiles[child].tile->Get());
    }
    static_cast<void>(DecodeBlock(value.substr(0, k), key, &kId, kMapOptions.limits));
  }
}

}  // namespace splinemap::layer_upload_test
