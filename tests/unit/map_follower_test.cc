#include "lib/replication/map_follower.h"

#include <gtest/gtest.h>

#include <string>
#include <variant>
#include <vector>

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_settings_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lib/layers/layer_pyramid.h"
#include "lib/replication/pyramid_publisher.h"
#include "lib/wire/encode.h"
#include "splinemap/map_view.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"
#include "tests/support/random_map.h"

namespace splinemap::map_follower_test {

using std::chrono::milliseconds;

constexpr MapOptions kOptions{0.05, {}};

// Of the followers here; owners have others.
constexpr uint64_t kSpeaker = 1;

// A daemon with one tile, and the messages that it sends.
class Owner {
 public:
  Owner(const std::string& name, uint64_t origin, MapOptions options = kOptions)
      : map_(options), layer_(map_.AddLayer({name, origin}, {1, 1000 + origin})) {
    publisher_ = std::make_unique<PyramidPublisher>(layer_.Snapshot(), options, PublisherOptions{});
  }

  void Commit(TileKey key, ControlPoint value) {
    layer_.BeginCommit();
    layer_.EditTile(key).control_points.fill(value);
  }
  Layer& layer() { return layer_; }
  void SpeakTo(MapFollower& follower, Clock::time_point now) {
    publisher_->SetLayer(layer_.Snapshot(), now);
    budget_.Refill(now, publisher_->HasChanges(), publisher_->HasPulls());
    for (const ReplicationMessage& message : publisher_->LastTick(now, budget_)) {
      follower.HandleBytes(EncodeReplication(message), now);
    }
  }

 private:
  MapWriter map_;
  Layer& layer_;
  std::unique_ptr<PyramidPublisher> publisher_;
  ByteBudget budget_{PublisherOptions().bytes_per_s};
};

std::vector<ReplicationMessage> TickOf(MapFollower& follower, Clock::time_point now) {
  ByteBudget budget(PublisherOptions().bytes_per_s);
  budget.Refill(now, false, follower.HasPulls());
  return follower.Tick(now, budget);
}

const Clock::time_point kBegin{std::chrono::hours(1)};

TEST(MapFollowerTest, LayersOfRobotsAddUp) {
  Owner one("one", 1);
  Owner two("two", 2);
  one.Commit({0, 0}, 100);
  two.Commit({0, 0}, 20);
  MapFollower follower({}, kSpeaker);
  one.SpeakTo(follower, kBegin);
  two.SpeakTo(follower, kBegin);
  EXPECT_EQ(FindTile(follower.View()->tiles, {0, 0})->control_points[0], 120);
  EXPECT_EQ(follower.SyncedLayers().layers.size(), 2u);
}

TEST(MapFollowerTest, TheLayerOfASilentRobotStays) {
  Owner one("one", 1);
  Owner two("two", 2);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, kSpeaker);
  one.SpeakTo(follower, kBegin);
  two.SpeakTo(follower, kBegin + std::chrono::hours(1));
  EXPECT_EQ(FindTile(follower.View()->tiles, {0, 0})->control_points[0], 100);
  EXPECT_FALSE(follower.FollowedLayers(kBegin + std::chrono::hours(1))[0].caught_up);
}

TEST(MapFollowerTest, ANewMapOfARobotReplacesTheOneBefore) {
  Owner before("one", 1);
  Owner after("one", 2);
  before.Commit({0, 0}, 100);
  after.Commit({5, 5}, 20);
  MapFollower follower({}, kSpeaker);
  before.SpeakTo(follower, kBegin);
  after.SpeakTo(follower, kBegin + milliseconds(1000));  // the other may still be there
  EXPECT_EQ(follower.Layers().layers.size(), 2u);
  after.SpeakTo(follower, kBegin + milliseconds(12'000));
  EXPECT_EQ(follower.Layers().layers.size(), 1u);
  const auto map = follower.View();
  EXPECT_EQ(map->tiles.Find({0, 0}), nullptr);
  EXPECT_EQ(FindTile(map->tiles, {5, 5})->control_points[0], 20);
}

TEST(MapFollowerTest, LayersOfAnotherKnotIntervalAreRefused) {
  Owner one("one", 1);
  Owner two("two", 2, {0.1, {}});
  MapFollower follower({}, kSpeaker);
  one.SpeakTo(follower, kBegin);
  two.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.FollowedLayers(kBegin).size(), 1u);
  EXPECT_EQ(follower.refused(),
            std::vector<std::string>{"two: its knot interval is 0.1 m, and 0.05 m here"});
}

// Whoever speaks first, once, does not decide for all that come after.
TEST(MapFollowerTest, KnotIntervalAndClampsAreThoseOfMostLayers) {
  Owner stranger("stranger", 9, {0.1, {}});
  stranger.Commit({0, 0}, 5);
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, kSpeaker);
  stranger.SpeakTo(follower, kBegin);
  one.SpeakTo(follower, kBegin + milliseconds(1000));
  EXPECT_EQ(follower.View()->options.knot_interval_m, 0.1);
  one.Commit({0, 0}, 100);
  one.Commit({0, 0}, 101);
  one.SpeakTo(follower, kBegin + milliseconds(6000));  // the stranger has said nothing since
  const auto map = follower.View();
  EXPECT_EQ(map->options, kOptions);
  ASSERT_NE(map->tiles.Find({0, 0}), nullptr);
  EXPECT_EQ(FindTile(map->tiles, {0, 0})->control_points[0], 101);
  EXPECT_TRUE(follower.refused().empty());
  // And one that goes on speaking is outvoted.
  Owner two("two", 2);
  for (milliseconds t(7000); t < milliseconds(9000); t += milliseconds(500)) {
    stranger.SpeakTo(follower, kBegin + t);
    one.SpeakTo(follower, kBegin + t);
    two.SpeakTo(follower, kBegin + t);
  }
  EXPECT_EQ(follower.View()->options, kOptions);
  EXPECT_EQ(follower.Layers().layers.size(), 2u);
  EXPECT_EQ(follower.refused().size(), 1u);
}

TEST(MapFollowerTest, EmptyLayersOfStrangersLockNobodyOutAndAreForgotten) {
  const LayerId kept{"kept", 4};
  MapWriter file(kOptions);
  Layer& layer = file.AddLayer(kept, {1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points.fill(50);
  KeeperOptions keeper;
  keeper.map_options = kOptions;
  keeper.own_layer = {"base", 3};
  MapFollower follower({}, keeper, file.Layers(), kSpeaker, kBegin);
  std::vector<Owner> strangers;
  for (uint64_t n = 0; n < 400; ++n) {
    strangers.emplace_back("stranger-" + std::to_string(n), n).SpeakTo(follower, kBegin);
  }
  EXPECT_EQ(follower.FollowedLayers(kBegin).size(), 256u);
  Owner robot("robot", 1);
  robot.Commit({0, 0}, 100);
  robot.SpeakTo(follower, kBegin + milliseconds(1000));
  for (Owner& stranger : strangers) stranger.SpeakTo(follower, kBegin + milliseconds(2000));
  robot.SpeakTo(follower, kBegin + milliseconds(3000));
  EXPECT_EQ(FindTile(follower.View()->tiles, {0, 0})->control_points[0], 150);
  TickOf(follower, kBegin + milliseconds(14'000));
  ASSERT_EQ(follower.Layers().layers.size(), 2u) << "all that have tiles";
  EXPECT_EQ(FindTile(follower.View()->tiles, {0, 0})->control_points[0], 150);
}

LayerSettings Setting(uint64_t counter, bool muted, uint64_t removed_up_to) {
  LayerSettings setting;
  setting.muted = muted;
  setting.counter = counter;
  setting.removed_up_to = removed_up_to;
  return setting;
}

std::vector<uint8_t> SettingsMessage(const LayerId& id, const LayerSettings& setting) {
  layer_settings_t record{};
  record.name = id.name;
  record.origin = static_cast<int64_t>(id.origin);
  record.muted = setting.muted ? 1 : 0;
  record.counter = static_cast<int64_t>(setting.counter);
  record.removed_up_to = static_cast<int64_t>(setting.removed_up_to);
  settings_t message{};
  message.speaker = 99;
  message.num_layers = 1;
  message.layers = {record};
  return Encode(message);
}

TEST(MapFollowerTest, SettingsFromTheBusAreIgnoredWhereNoneAreTaken) {
  for (const bool takes_settings : {true, false}) {
    Owner one("one", 1);
    one.Commit({0, 0}, 100);
    FollowOptions options;
    options.takes_settings = takes_settings;
    MapFollower follower(options, kSpeaker);
    one.SpeakTo(follower, kBegin);
    const auto value = [&] {
      const auto tile = FindTile(follower.View()->tiles, {0, 0});
      return tile == nullptr ? 0 : tile->control_points[0];
    };
    ASSERT_EQ(value(), 100);
    follower.HandleBytes(SettingsMessage({"one", 1}, Setting(1, true, 0)), kBegin);
    EXPECT_EQ(value(), takes_settings ? 0 : 100);
    follower.HandleBytes(SettingsMessage({"one", 1}, Setting(2, false, 1)), kBegin);
    EXPECT_EQ(value(), takes_settings ? 0 : 100);
    EXPECT_EQ(follower.FollowedLayers(kBegin).size(), takes_settings ? 0u : 1u);
    for (const ReplicationMessage& message : TickOf(follower, kBegin + milliseconds(1000))) {
      EXPECT_TRUE(takes_settings || !std::holds_alternative<settings_t>(message));
    }
  }
}

// A daemon's list of one layer.
layers_t ListOf(const LayerId& id, uint64_t session_number, int64_t num_tiles) {
  layer_status_t layer{};
  layer.settings = ToMessage(id, {}, /*has_layer=*/true);
  layer.session_number = static_cast<int64_t>(session_number);
  layer.state = "gone";
  layer.num_tiles = num_tiles;
  layers_t list{};
  list.daemon_nonce = 77;
  list.name = "base";
  list.num_layers = 1;
  list.layers = {layer};
  return list;
}

TEST(MapFollowerTest, ALayerThatADaemonHasAndNobodyDigestsIsMissing) {
  Owner one("one", 1);
  Owner absent("absent", 2);
  one.Commit({0, 0}, 100);
  absent.Commit({0, 0}, 20);
  MapFollower follower({}, kSpeaker);
  Clock::time_point now = kBegin;
  const auto pass = [&](milliseconds time) {
    for (const Clock::time_point end = now + time; now < end; now += milliseconds(50)) {
      TickOf(follower, now);
    }
    one.SpeakTo(follower, now);
  };
  one.SpeakTo(follower, now);
  EXPECT_FALSE(follower.IsCaughtUp(now));  // others may still answer
  pass(milliseconds(2000));
  EXPECT_TRUE(follower.IsCaughtUp(now));
  follower.HandleBytes(Encode(ListOf({"empty", 3}, 1, 0)), now);
  follower.HandleBytes(Encode(ListOf({"one", 1}, 1, 1)), now);
  EXPECT_TRUE(follower.IsCaughtUp(now));
  follower.HandleBytes(Encode(ListOf({"absent", 2}, 1, 1)), now);
  EXPECT_FALSE(follower.IsCaughtUp(now));
  ASSERT_EQ(follower.FollowedLayers(now).size(), 2u);
  EXPECT_EQ(follower.FollowedLayers(now)[1].id, (LayerId{"absent", 2}));
  EXPECT_FALSE(follower.FollowedLayers(now)[1].caught_up);
  absent.SpeakTo(follower, now);
  EXPECT_TRUE(follower.IsCaughtUp(now));
  EXPECT_EQ(follower.FollowedLayers(now).size(), 2u);
}

TEST(MapFollowerTest, ARemovedSessionIsNotFollowedAgain) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, kSpeaker);
  one.SpeakTo(follower, kBegin);
  follower.HandleBytes(SettingsMessage({"one", 1}, Setting(1, false, 1)), kBegin);
  one.SpeakTo(follower, kBegin + milliseconds(1000));
  EXPECT_TRUE(follower.FollowedLayers(kBegin + milliseconds(1000)).empty());
}

TEST(MapFollowerTest, WhatIsNotFollowedIsNotMissing) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  FollowOptions options;
  options.names = {"one", "removed"};
  MapFollower follower(options, kSpeaker);
  follower.HandleBytes(SettingsMessage({"removed", 3}, Setting(1, false, 5)), kBegin);
  follower.HandleBytes(Encode(ListOf({"other", 2}, 1, 1)), kBegin);
  follower.HandleBytes(Encode(ListOf({"removed", 3}, 5, 1)), kBegin);
  one.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.FollowedLayers(kBegin).size(), 1u);
  follower.HandleBytes(Encode(ListOf({"removed", 3}, 6, 1)), kBegin);
  EXPECT_EQ(follower.FollowedLayers(kBegin).size(), 2u);
  // Daemons that are not there any more have nothing.
  EXPECT_EQ(follower.FollowedLayers(kBegin + milliseconds(4000)).size(), 1u);
}

TEST(MapFollowerTest, AStartOrARemovalThatNobodyCountsToIsIgnored) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, kSpeaker);
  // Of the removal the follower hears before the layer.
  follower.HandleBytes(SettingsMessage({"one", 1}, Setting(1, false, 1ull << 61)), kBegin);
  one.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.Layers().layers.size(), 1u);
  follower.HandleBytes(SettingsMessage({"one", 1}, Setting(1, false, 1ull << 61)), kBegin);
  EXPECT_EQ(follower.Layers().layers.size(), 1u);
  layer_digest_t digest{};
  digest.speaker = 1001;
  digest.layer = ToMessage({{"one", 1}, {LayerSettings::kMaxSessionsAhead + 2, 1001}, {}});
  digest.protocol_version = kProtocolVersion;
  digest.knot_interval_m = kOptions.knot_interval_m;
  digest.min_control_point = kOptions.limits.min;
  digest.max_control_point = kOptions.limits.max;
  digest.root_level = 1;
  follower.HandleBytes(Encode(digest), kBegin);
  EXPECT_EQ(follower.malformed(), 1);
  one.SpeakTo(follower, kBegin + milliseconds(1000));
  EXPECT_TRUE(follower.FollowedLayers(kBegin + milliseconds(1000))[0].caught_up);
  // A true one is not.
  follower.HandleBytes(SettingsMessage({"one", 1}, Setting(1, false, 1)), kBegin);
  EXPECT_TRUE(follower.Layers().layers.empty());
}

TEST(MapFollowerTest, ARegionIsOfTheMapFrameAtAnyLevel) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  one.Commit({9, 0}, 100);
  FollowOptions options;
  options.region = Region{0.2, 0.2, 1.4, 1.4};
  MapFollower follower(options, kSpeaker);
  one.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.Layers().layers[0].tiles.size(), 1u);
  EXPECT_EQ(follower.View()->options, kOptions);

  // Of a layer that is placed, the tiles that come to the region.
  LayerSettings placed = follower.settings().Next({"two", 2}, 7);
  placed.placement = PlacedAt(0.8, 10 * 1.6, -90);
  follower.Set({"two", 2}, placed);
  Owner two("two", 2);
  two.Commit({0, 0}, 100);
  two.Commit({9, 0}, 100);
  two.SpeakTo(follower, kBegin);
  const TileTree tiles = follower.Layers().layers[1].tiles;
  EXPECT_NE(tiles.Find({9, 0}), nullptr);
  EXPECT_EQ(tiles.Find({0, 0}), nullptr);

  // A level that its daemon makes.
  options.level_of_detail = {3, Statistic::kMax};
  options.takes_tiles = true;
  MapFollower coarse(options, kSpeaker);
  one.SpeakTo(coarse, kBegin);
  EXPECT_DOUBLE_EQ(coarse.View()->options.knot_interval_m, 0.4);
  const auto messages = TickOf(coarse, kBegin + milliseconds(200));
  ASSERT_EQ(messages.size(), 2u);
  EXPECT_TRUE(IsCall(std::get<layer_pull_t>(messages[0])));
  const auto& pull = std::get<layer_pull_t>(messages[1]);
  EXPECT_EQ(pull.layer.level, 3);
  EXPECT_EQ(pull.layer.statistic, 2);
}

TEST(MapFollowerTest, ALevelThatIsMadeHereIsThatOfTheDaemon) {
  for (const Statistic statistic : {Statistic::kMean, Statistic::kMin, Statistic::kMax}) {
    for (const bool is_of_region : {false, true}) {
      Owner one("one", 1);
      std::mt19937_64 random(5);
      for (int n = 0; n < 200; ++n) {
        one.Commit(RandomKey(random, 20), static_cast<ControlPoint>(100 + n));
      }
      FollowOptions options;
      options.level_of_detail = {2, statistic};
      if (is_of_region) options.region = Region{-7, -3, 12, 9};
      MapFollower follower(options, kSpeaker);
      one.SpeakTo(follower, kBegin);
      LayerPyramid levels(2);
      levels.Advance(one.layer().Snapshot(), 1'000'000);
      const TileTree expected = levels.Layer(options.level_of_detail).tiles;
      const TileTree tiles = follower.Layers().layers.at(0).tiles;
      size_t in_region = 0;
      expected.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        const bool is_in =
            !is_of_region || (key.tx >= -2 && key.tx <= 1 && key.ty >= -1 && key.ty <= 1);
        in_region += is_in ? 1 : 0;
        const auto tile = FindTile(tiles, key);
        EXPECT_EQ(tile != nullptr, is_in) << key.tx << " " << key.ty;
        if (tile != nullptr) {
          EXPECT_EQ(*tile, *entry.tile->Get());
        }
      });
      EXPECT_EQ(tiles.size(), in_region);
      EXPECT_GT(in_region, 0u);
      EXPECT_DOUBLE_EQ(follower.View()->options.knot_interval_m, 0.2);
      // Goes on with what changes.
      const LayerSnapshot before = follower.Layers().layers.at(0);
      one.Commit({1, 1}, 77);
      one.SpeakTo(follower, kBegin + milliseconds(1000));
      EXPECT_NE(follower.Layers().layers.at(0).tiles.version(), before.tiles.version());
    }
  }
}

// As an uplink follows: it keeps layers, and has none of its own.
MapFollower Keeper() {
  return MapFollower({}, KeeperOptions{kOptions, {}, 0}, LayerSet(), kSpeaker, kBegin);
}

TEST(MapFollowerTest, AnAdoptedLayerIsSpokenFor) {
  Owner one("one", 1);  // which nobody hears
  one.Commit({0, 0}, 100);
  MapFollower keeper = Keeper();
  ASSERT_TRUE(keeper.Adopt(one.layer().Snapshot(), kBegin));
  MapFollower other({}, kSpeaker + 1);
  for (milliseconds t(0); t < milliseconds(10'000); t += milliseconds(50)) {
    if (t == milliseconds(5000)) {
      one.Commit({0, 0}, 110);
      one.Commit({7, 7}, 5);
      ASSERT_TRUE(keeper.Adopt(one.layer().Snapshot(), kBegin + t));
    }
    for (const ReplicationMessage& message : TickOf(keeper, kBegin + t)) {
      other.HandleBytes(EncodeReplication(message), kBegin + t);
    }
    for (const ReplicationMessage& message : TickOf(other, kBegin + t)) {
      keeper.HandleBytes(EncodeReplication(message), kBegin + t);
    }
    if (t == milliseconds(4900)) {
      ASSERT_EQ(other.SyncedLayers().layers.size(), 1u);
      EXPECT_EQ(other.SyncedLayers().layers[0].session, one.layer().Snapshot().session);
      EXPECT_EQ(FindTile(other.View()->tiles, {0, 0})->control_points[0], 100);
    }
  }
  EXPECT_EQ(other.SyncedLayers().layers[0].revision, one.layer().revision());
  EXPECT_EQ(FindTile(other.View()->tiles, {0, 0})->control_points[0], 110);
  EXPECT_EQ(FindTile(other.View()->tiles, {7, 7})->control_points[0], 5);
}

TEST(MapFollowerTest, TheCopyOfASilentOwnerTakesNewerTiles) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  one.Commit({1, 0}, 50);
  MapFollower keeper = Keeper();
  one.SpeakTo(keeper, kBegin);
  const LayerSnapshot heard = one.layer().Snapshot();
  one.Commit({0, 0}, 110);
  one.Commit({7, 7}, 5);
  const Clock::time_point later = kBegin + std::chrono::minutes(1);
  ASSERT_TRUE(keeper.Adopt(one.layer().Snapshot(), later));
  EXPECT_TRUE(keeper.Adopt(heard, later));  // has nothing newer
  const auto map = keeper.View();
  EXPECT_EQ(FindTile(map->tiles, {0, 0})->control_points[0], 110);
  EXPECT_EQ(FindTile(map->tiles, {1, 0})->control_points[0], 50);
  EXPECT_EQ(FindTile(map->tiles, {7, 7})->control_points[0], 5);
  EXPECT_EQ(keeper.Layers().layers[0].revision, one.layer().revision());
}

TEST(MapFollowerTest, AnOwnerThatIsHeardIsLeftAlone) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  MapFollower keeper = Keeper();
  one.SpeakTo(keeper, kBegin);
  one.Commit({0, 0}, 110);
  EXPECT_FALSE(keeper.Adopt(one.layer().Snapshot(), kBegin + milliseconds(500)));
  EXPECT_EQ(FindTile(keeper.View()->tiles, {0, 0})->control_points[0], 100);
  one.SpeakTo(keeper, kBegin + milliseconds(1000));  // which says it itself
  EXPECT_EQ(FindTile(keeper.View()->tiles, {0, 0})->control_points[0], 110);
}

TEST(MapFollowerTest, ALayerOfAnotherSessionIsAdoptedAsAWholeIfItIsLater) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  LayerSnapshot older = one.layer().Snapshot();
  MapFollower keeper = Keeper();
  one.SpeakTo(keeper, kBegin);
  Owner begun("one", 1);  // which has forgotten the tile
  begun.Commit({7, 7}, 5);
  LayerSnapshot later = begun.layer().Snapshot();
  later.session = {2, 1};
  const Clock::time_point now = kBegin + std::chrono::minutes(1);
  ASSERT_TRUE(keeper.Adopt(later, now));
  EXPECT_FALSE(keeper.Adopt(older, now));
  EXPECT_EQ(keeper.View()->tiles.Find({0, 0}), nullptr);
  EXPECT_EQ(FindTile(keeper.View()->tiles, {7, 7})->control_points[0], 5);
  EXPECT_EQ(keeper.Layers().layers[0].session, later.session);
}

TEST(MapFollowerTest, WhatIsNotFollowedOrWasRemovedIsNotAdopted) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  const LayerSnapshot layer = one.layer().Snapshot();
  FollowOptions others;
  others.names = {"two"};
  MapFollower keeper(others, KeeperOptions{kOptions, {}, 0}, LayerSet(), kSpeaker, kBegin);
  EXPECT_FALSE(keeper.Adopt(layer, kBegin));
  MapFollower other = Keeper();
  LayerSettings removed;
  removed.Remove(layer.session);
  other.Set(layer.id, removed);
  EXPECT_FALSE(other.Adopt(layer, kBegin));
  EXPECT_TRUE(other.Layers().layers.empty());
}

}  // namespace splinemap::map_follower_test
