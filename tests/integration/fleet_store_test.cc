#include <gtest/gtest.h>

#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/layer_digest.h"
#include "lib/fleet/layer_upload.h"
#include "lib/fleet/nats_fleet_store.h"
#include "splinemap/map_view.h"
#include "tests/support/nats_server.h"
#include "tests/support/random_map.h"

namespace splinemap::fleet_store_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr auto kUnpaced = [](int64_t) { return true; };

template <typename Condition>
bool WaitUntil(Condition is_met, seconds timeout = seconds(20)) {
  for (const auto end = Clock::now() + timeout; Clock::now() < end;) {
    if (is_met()) return true;
    std::this_thread::sleep_for(milliseconds(10));
  }
  return is_met();
}

// A real nats-server with a bucket.
class FleetStoreTest : public testing::Test {
 protected:
  FleetStoreTest() {
    auto store = NatsFleetStore::Connect(server_.address());
    EXPECT_TRUE(store.ok()) << store.status();
    store_ = *std::move(store);
    EXPECT_EQ(store_->MakeBucket(1), absl::OkStatus());
  }

  std::map<std::string, FleetEntry> Listed(const std::string& filter, bool with_values) {
    std::map<std::string, FleetEntry> listed;
    EXPECT_EQ(store_->List(filter, with_values,
                           [&](FleetEntry entry) {
                             EXPECT_TRUE(listed.emplace(entry.key, entry).second) << entry.key;
                           }),
              absl::OkStatus());
    return listed;
  }

  NatsServer server_;
  std::unique_ptr<NatsFleetStore> store_;
};

TEST_F(FleetStoreTest, WhatIsPutIsListedAndRead) {
  const std::string large(500'000, 'x');
  ASSERT_EQ(store_->Put({{"a.b", "1", 11}, {"a.c", large, 12}, {"d", "3", 13}, {"a.b", "4", 14}}),
            absl::OkStatus());
  const auto all = Listed(">", true);
  ASSERT_EQ(all.size(), 3u);
  EXPECT_EQ(all.at("a.b").value, "4");
  EXPECT_EQ(all.at("a.b").hash, 14u);
  EXPECT_EQ(all.at("a.c").value, large);
  EXPECT_GT(all.at("a.b").revision, all.at("d").revision);
  const auto some = Listed("a.*", false);
  ASSERT_EQ(some.size(), 2u);
  EXPECT_EQ(some.at("a.c").value, "");
  EXPECT_EQ(some.at("a.c").hash, 12u);
  EXPECT_TRUE(Listed("nothing.>", true).empty());
  const auto read = store_->Get("a.c");
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->value, large);
  EXPECT_EQ(read->revision, all.at("a.c").revision);
  EXPECT_TRUE(absl::IsOutOfRange(store_->Get("a.x").status()));
}

TEST_F(FleetStoreTest, AKeyThatIsRemovedHasNoHash) {
  ASSERT_EQ(store_->Put({{"a", "1", 11}, {"a", "", 0}}), absl::OkStatus());
  EXPECT_EQ(Listed(">", false).at("a").hash, 0u);
  EXPECT_EQ(store_->Get("a")->value, "");
}

TEST_F(FleetStoreTest, OfTwoWhoWriteOneIsRefused) {
  const auto first = store_->PutIf({"a", "1", 11}, 0);
  ASSERT_TRUE(first.ok()) << first.status();
  EXPECT_TRUE(absl::IsAborted(store_->PutIf({"a", "2", 12}, 0).status()));
  EXPECT_TRUE(store_->PutIf({"a", "3", 13}, *first).ok());
  EXPECT_TRUE(absl::IsAborted(store_->PutIf({"a", "4", 14}, *first).status()));
  EXPECT_EQ(store_->Get("a")->value, "3");
}

TEST_F(FleetStoreTest, ChangesAreToldInOrderWithTheirRevision) {
  Mutex mutex;
  std::vector<FleetEntry> told;
  const auto subscription = store_->Subscribe("a.>", [&](FleetEntry entry) {
    MutexLock lock(mutex);
    told.push_back(std::move(entry));
  });
  ASSERT_TRUE(subscription.ok()) << subscription.status();
  ASSERT_EQ(store_->Put({{"a.b", "1", 11}, {"b", "2", 12}, {"a.c", "3", 13}, {"a.b", "", 0}}),
            absl::OkStatus());
  ASSERT_TRUE(WaitUntil([&] {
    MutexLock lock(mutex);
    return told.size() >= 3;
  }));
  MutexLock lock(mutex);
  ASSERT_EQ(told.size(), 3u);
  EXPECT_EQ(told[0].key, "a.b");
  EXPECT_EQ(told[0].hash, 11u);
  EXPECT_EQ(told[0].value, "1");
  EXPECT_EQ(told[1].key, "a.c");
  EXPECT_EQ(told[2].value, "");
  EXPECT_EQ(told[2].revision, store_->Get("a.b")->revision);
}

TEST_F(FleetStoreTest, AServerThatIsKilledIsFoundAgainAndKeepsWhatItHad) {
  ASSERT_EQ(store_->Put({{"a", "1", 11}}), absl::OkStatus());
  const uint64_t before = store_->connections();
  server_.Kill();
  EXPECT_FALSE(store_->Put({{"a", "2", 12}}).ok());
  EXPECT_TRUE(WaitUntil([&] { return !store_->Problem().empty(); }));
  server_.Start();
  ASSERT_TRUE(WaitUntil([&] { return store_->connections() > before; }));
  EXPECT_TRUE(WaitUntil([&] { return store_->Put({{"b", "3", 13}}).ok(); }));
  EXPECT_EQ(store_->Get("a")->value, "1");
}

TEST_F(FleetStoreTest, WhatIsNotThereIsNamed) {
  FleetAddress nobody = server_.address();
  nobody.servers = "nats://127.0.0.1:" + std::to_string(FreePort());
  EXPECT_EQ(ErrorText(NatsFleetStore::Connect(nobody).status()),
            "no NATS server answers at " + nobody.servers + "; is nats-server running there?");
  const auto other = NatsFleetStore::Connect(server_.address("elsewhere"));
  ASSERT_TRUE(other.ok());
  const std::string text = ErrorText((*other)->Put({{"a", "1", 11}}));
  EXPECT_NE(text.find("'elsewhere'"), std::string::npos) << text;
  const auto version = ServerVersion(server_.address());
  ASSERT_TRUE(version.ok()) << version.status();
  EXPECT_EQ(std::count(version->begin(), version->end(), '.'), 2) << *version;
}

TEST_F(FleetStoreTest, AReplicaHasWhatRobotsBringAlsoAfterTheServerForgotEverything) {
  const MapOptions options{0.05, {-2560, 2560}};
  ASSERT_TRUE(store_->PutIf({kMapKey, EncodeMapOptions(options), 1}, 0).ok());
  std::mt19937_64 random(1);
  FleetReplica replica(*store_, {});
  Layer layer(LayerId{"robot one", 7}, SessionId{1, 2});
  LayerUpload upload(*store_, layer.id(), options);
  const auto commit_and_bring = [&] {
    layer.BeginCommit();
    for (int k = 0; k < 20; ++k) {
      layer.EditTile(RandomKey(random, 30)) = RandomTile(random, options.limits);
    }
    return upload.Bring(layer.Snapshot(), kUnpaced);
  };
  const auto has_layer = [&] {
    const LayerSet set = replica.WholeLayers();
    const LayerSnapshot* copy = set.Find(layer.id());
    if (copy == nullptr || copy->tiles.size() != layer.tiles().size()) return false;
    bool is_equal = copy->revision == layer.revision();
    copy->tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      const auto tile = FindTile(layer.tiles(), key);
      is_equal &= tile != nullptr && *tile == *entry.tile->Get();
    });
    return is_equal;
  };
  for (int k = 0; k < 5; ++k) {
    ASSERT_EQ(commit_and_bring(), absl::OkStatus());
    EXPECT_TRUE(WaitUntil(has_layer)) << replica.Problem();
  }
  // One who comes late.
  FleetReplica late(*store_, {});
  EXPECT_TRUE(WaitUntil([&] { return late.IsCaughtUp(); }));
  EXPECT_EQ(late.Layers().layers.size(), 1u);

  server_.Kill();
  server_.Forget();
  server_.Start();
  ASSERT_TRUE(WaitUntil([&] { return store_->Problem().empty(); }));
  ASSERT_TRUE(WaitUntil([&] { return store_->MakeBucket(1).ok(); }));
  ASSERT_TRUE(store_->PutIf({kMapKey, EncodeMapOptions(options), 1}, 0).ok());
  ASSERT_TRUE(WaitUntil([&] { return commit_and_bring().ok(); }));
  EXPECT_TRUE(WaitUntil(has_layer)) << replica.Problem();
}

}  // namespace splinemap::fleet_store_test
