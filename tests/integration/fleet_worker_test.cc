// Two workers of a fleet and a NATS server, as programs; run it on a network of its own.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <map>
#include <memory>
#include <random>
#include <thread>

#include "lib/base/status.h"
#include "lib/fleet/fleet_map.h"
#include "lib/fleet/layer_block.h"
#include "lib/fleet/layer_upload.h"
#include "lib/fleet/nats_fleet_store.h"
#include "lib/fleet/sum_block.h"
#include "splinemap/local_map.h"
#include "tests/support/child_process.h"
#include "tests/support/map_writer.h"
#include "tests/support/queries.h"
#include "tests/support/random_map.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class FleetWorkerTest : public testing::Test {
 protected:
  FleetWorkerTest()
      : server_({"/usr/sbin/nats-server", "-a", "127.0.0.1", "-p", "4433", "-js", "-sd",
                 folder_.path(), "-l", folder_.File("log")}) {
    address_.servers = "nats://127.0.0.1:4433";
    address_.map = "office";
    address_.program = "test";
    for (const char* const name : {"robot-1", "robot-2"}) Change(map_.AddLayer({name, 1}, {1, 1}));
  }

  std::unique_ptr<ChildProcess> StartWorker() {
    return std::make_unique<ChildProcess>(std::vector<std::string>{
        SPLINEMAP_FLEET_WORKER, "--fleet", address_.servers, "--fleet-map", address_.map});
  }
  template <typename Condition>
  static bool Wait(Condition is_met) {
    const auto end = std::chrono::steady_clock::now() + seconds(30);
    while (std::chrono::steady_clock::now() < end) {
      if (is_met()) return true;
      std::this_thread::sleep_for(milliseconds(50));
    }
    return false;
  }
  static std::unique_ptr<NatsFleetStore> Connect(const FleetAddress& address) {
    std::unique_ptr<NatsFleetStore> store;
    Wait([&] {
      auto connected = NatsFleetStore::Connect(address);
      if (connected.ok()) store = *std::move(connected);
      return store != nullptr;
    });
    return store;
  }

  void Change(Layer& layer) {
    layer.BeginCommit();
    for (int k = 0; k < 60; ++k) {
      layer.EditTile(RandomKey(random_, 40)) = RandomTile(random_, map_.options().limits);
    }
  }
  void Upload(NatsFleetStore& store, const LayerSet& set) {
    for (const LayerSnapshot& layer : set.layers) {
      LayerUpload upload(store, layer.id, map_.options());
      const absl::Status status = upload.Bring(layer, [](int64_t) { return true; });
      ASSERT_TRUE(status.ok()) << status;
    }
  }
  // Whether the fleet answers as this map.
  bool AnswersAs(const QueryableMap& fleet, const LocalMap& whole) {
    const auto is_same = [&](const auto& query) {
      const auto expected = whole.Ask(query);
      const auto found = fleet.Ask(query);
      if (!found.ok()) ADD_FAILURE() << found.status();
      return expected.ok() && found.ok() && AreSame(*found, *expected);
    };
    return is_same(RandomPoints(random_, 200)) && is_same(RandomRays(random_, 20)) &&
           is_same(RandomSweeps(random_, 10)) && is_same(RandomRaster(random_, 5000)) &&
           is_same(RandomLikelihoods(random_, 5)) && is_same(RandomDistances(random_, 20));
  }
  // Whether the bucket of sums has the tiles of this map, and no others.
  bool SumIs(NatsFleetStore& sums, const MapView& view) const {
    std::map<TileKey, uint64_t> expected;
    view.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      expected[key] = entry.tile->Checksum(key);
    });
    std::map<TileKey, uint64_t> found;
    const absl::Status listed = sums.List("sum.>", true, [&](const FleetEntry& entry) {
      const auto key = ParseSumKey(entry.key);
      if (!key) return;
      const auto block = DecodeBlock(entry.value, *key, nullptr, view.options.limits);
      if (!block.ok()) return;
      for (int child = 0; child < 16; ++child) {
        const auto& tile = block->tiles[child].tile;
        if (tile) found[key->Tile(child)] = tile->Checksum(key->Tile(child));
      }
    });
    return listed.ok() && found == expected;
  }

  std::mt19937_64 random_{3};
  MapWriter map_{{0.05, {-64 * 256, 64 * 256}}};
  TemporaryDirectory folder_;
  FleetAddress address_;
  ChildProcess server_;
};

TEST_F(FleetWorkerTest, AnswersGoOnWhenAWorkerIsKilled) {
  auto first = StartWorker();
  Connect(address_);  // the server is there
  if (kill(first->pid(), 0) != 0) first = StartWorker();
  auto second = StartWorker();
  const auto store = Connect(address_);
  ASSERT_TRUE(Wait([&] { return store->Get(kMapKey).ok(); }));
  FleetAddress sum_address = address_;
  sum_address.map += "_sum";
  const auto sums = Connect(sum_address);

  Upload(*store, map_.Layers());
  auto fleet = FleetMap::Connect(address_, seconds(20));
  ASSERT_TRUE(fleet.ok()) << fleet.status();
  EXPECT_EQ((*fleet)->options(), map_.options());
  const auto revision_is = [&](uint64_t revision) {
    return Wait([&] {
      const auto points = (*fleet)->Ask(PointsQuery{{{0, 0}}});
      return points.ok() && points->revision == revision;
    });
  };
  ASSERT_TRUE(revision_is(2));
  LocalMap whole(map_.View());
  EXPECT_TRUE(Wait([&] { return AnswersAs(**fleet, whole); }));
  EXPECT_TRUE(Wait([&] { return SumIs(*sums, *whole.View()); }));

  // Killed while it is asked, and no answer is missing or wrong.
  kill(first->pid(), SIGKILL);
  const auto killed = std::chrono::steady_clock::now();
  while (std::chrono::steady_clock::now() - killed < seconds(6)) {
    ASSERT_TRUE(AnswersAs(**fleet, whole));
  }

  // What changes from now on is answered and published by the one that is left.
  Change(map_.layer(0));
  whole.Use(map_.View());
  Upload(*store, map_.Layers());
  EXPECT_TRUE(revision_is(3));
  EXPECT_TRUE(Wait([&] { return AnswersAs(**fleet, whole); }));
  EXPECT_TRUE(Wait([&] { return SumIs(*sums, *whole.View()); }));

  // Another one takes its share, and the one that had all parts is killed.
  const auto third = StartWorker();
  std::this_thread::sleep_for(seconds(5));
  kill(second->pid(), SIGKILL);
  EXPECT_TRUE(AnswersAs(**fleet, whole));
}

}  // namespace
}  // namespace splinemap
