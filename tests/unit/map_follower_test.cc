#include "lib/following/map_follower.h"

#include <gtest/gtest.h>

#include <string>
#include <variant>
#include <vector>

#include "lib/map/map.h"
#include "lib/replication/levels_publisher.h"
#include "lib/wire/encode.h"

namespace splinemap::map_follower_test {

using std::chrono::milliseconds;

constexpr MapOptions kOptions{0.05, {}};

// A daemon with one tile, and the messages that it sends.
class Owner {
 public:
  Owner(const std::string& name, uint64_t origin, MapOptions options = kOptions)
      : map_(options), layer_(map_.AddLayer({name, origin}, {1, 1})) {
    publisher_ = std::make_unique<LevelsPublisher>(layer_.Snapshot(), options, PublisherOptions{});
  }

  void Commit(TileKey key, ControlPoint value) {
    layer_.BeginCommit();
    layer_.EditTile(key).control_points.fill(value);
  }
  void SpeakTo(MapFollower& follower, Clock::time_point now) {
    publisher_->SetLayer(layer_.Snapshot(), now);
    for (const PublishedMessage& message : publisher_->LastTick(now)) {
      std::visit([&](const auto& m) { follower.HandleMessage(Encode(m), now); }, message);
    }
  }

 private:
  Map map_;
  Layer& layer_;
  std::unique_ptr<LevelsPublisher> publisher_;
};

const Clock::time_point kBegin{std::chrono::hours(1)};

TEST(MapFollowerTest, LayersOfRobotsAddUp) {
  Owner one("one", 1);
  Owner two("two", 2);
  one.Commit({0, 0}, 100);
  two.Commit({0, 0}, 20);
  MapFollower follower({}, 1);
  one.SpeakTo(follower, kBegin);
  two.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.Snapshot()->merged.Find({0, 0})->control_points[0], 120);
  EXPECT_EQ(follower.WholeSnapshot()->layers.size(), 2u);
}

TEST(MapFollowerTest, TheLayerOfASilentRobotStays) {
  Owner one("one", 1);
  Owner two("two", 2);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, 1);
  one.SpeakTo(follower, kBegin);
  two.SpeakTo(follower, kBegin + std::chrono::hours(1));
  EXPECT_EQ(follower.Snapshot()->merged.Find({0, 0})->control_points[0], 100);
  EXPECT_FALSE(follower.Layers(kBegin + std::chrono::hours(1))[0].in_sync);
}

TEST(MapFollowerTest, ANewMapOfARobotReplacesTheOneBefore) {
  Owner before("one", 1);
  Owner after("one", 2);
  before.Commit({0, 0}, 100);
  after.Commit({5, 5}, 20);
  MapFollower follower({}, 1);
  before.SpeakTo(follower, kBegin);
  after.SpeakTo(follower, kBegin + milliseconds(1000));  // the other may still be there
  EXPECT_EQ(follower.Snapshot()->layers.size(), 2u);
  after.SpeakTo(follower, kBegin + milliseconds(12'000));
  const auto map = follower.Snapshot();
  EXPECT_EQ(map->layers.size(), 1u);
  EXPECT_EQ(map->merged.Find({0, 0}), nullptr);
  EXPECT_EQ(map->merged.Find({5, 5})->control_points[0], 20);
}

TEST(MapFollowerTest, LayersOfAnotherKnotIntervalAreRefused) {
  Owner one("one", 1);
  Owner two("two", 2, {0.1, {}});
  MapFollower follower({}, 1);
  one.SpeakTo(follower, kBegin);
  two.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.Layers(kBegin).size(), 1u);
  EXPECT_EQ(follower.refused(),
            std::vector<std::string>{"two: its knot interval is 0.1 m, and 0.05 m here"});
}

// Whoever speaks first, once, does not decide for all that come after.
TEST(MapFollowerTest, KnotIntervalAndClampsAreThoseOfMostLayers) {
  Owner stranger("stranger", 9, {0.1, {}});
  stranger.Commit({0, 0}, 5);
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, 1);
  stranger.SpeakTo(follower, kBegin);
  one.SpeakTo(follower, kBegin + milliseconds(1000));
  EXPECT_EQ(follower.Snapshot()->options.knot_interval_m, 0.1);
  one.Commit({0, 0}, 100);
  one.Commit({0, 0}, 101);
  one.SpeakTo(follower, kBegin + milliseconds(6000));  // the stranger has said nothing since
  const auto map = follower.Snapshot();
  EXPECT_EQ(map->options, kOptions);
  ASSERT_NE(map->merged.Find({0, 0}), nullptr);
  EXPECT_EQ(map->merged.Find({0, 0})->control_points[0], 101);
  EXPECT_TRUE(follower.refused().empty());
  // And one that goes on speaking is outvoted.
  Owner two("two", 2);
  for (milliseconds t(7000); t < milliseconds(9000); t += milliseconds(500)) {
    stranger.SpeakTo(follower, kBegin + t);
    one.SpeakTo(follower, kBegin + t);
    two.SpeakTo(follower, kBegin + t);
  }
  EXPECT_EQ(follower.Snapshot()->options, kOptions);
  EXPECT_EQ(follower.Snapshot()->layers.size(), 2u);
  EXPECT_EQ(follower.refused().size(), 1u);
}

TEST(MapFollowerTest, EmptyLayersOfStrangersLockNobodyOutAndAreForgotten) {
  const LayerId kept{"kept", 4};
  Map file(kOptions);
  Layer& layer = file.AddLayer(kept, {1, 1});
  layer.BeginCommit();
  layer.EditTile({0, 0}).control_points.fill(50);
  Keeper keeper;
  keeper.map_options = kOptions;
  keeper.own_layer = {"base", 3};
  MapFollower follower({}, keeper, *file.Snapshot(), 1, kBegin);
  std::vector<Owner> strangers;
  for (uint64_t n = 0; n < 400; ++n) {
    strangers.emplace_back("stranger-" + std::to_string(n), n).SpeakTo(follower, kBegin);
  }
  EXPECT_EQ(follower.Layers(kBegin).size(), 256u);
  Owner robot("robot", 1);
  robot.Commit({0, 0}, 100);
  robot.SpeakTo(follower, kBegin + milliseconds(1000));
  for (Owner& stranger : strangers) stranger.SpeakTo(follower, kBegin + milliseconds(2000));
  robot.SpeakTo(follower, kBegin + milliseconds(3000));
  EXPECT_EQ(follower.Snapshot()->merged.Find({0, 0})->control_points[0], 150);
  follower.Tick(kBegin + milliseconds(14'000));
  const auto map = follower.Snapshot();
  ASSERT_EQ(map->layers.size(), 2u) << "all that have tiles";
  EXPECT_EQ(map->merged.Find({0, 0})->control_points[0], 150);
}

LayerControl Control(uint64_t counter, bool muted, uint64_t removed_up_to) {
  LayerControl control;
  control.muted = muted;
  control.counter = counter;
  control.removed_up_to = removed_up_to;
  return control;
}

std::vector<uint8_t> Decision(const LayerId& id, const LayerControl& control) {
  layer_control_t record{};
  record.name = id.name;
  record.origin = static_cast<int64_t>(id.origin);
  record.muted = control.muted ? 1 : 0;
  record.counter = static_cast<int64_t>(control.counter);
  record.removed_up_to = static_cast<int64_t>(control.removed_up_to);
  control_records_t message{};
  message.sender = 99;
  message.num_records = 1;
  message.records = {record};
  return Encode(message);
}

TEST(MapFollowerTest, DecisionsFromTheBusAreIgnoredWhereNoneAreTaken) {
  for (const bool takes_decisions : {true, false}) {
    Owner one("one", 1);
    one.Commit({0, 0}, 100);
    FollowOptions options;
    options.takes_decisions = takes_decisions;
    MapFollower follower(options, 1);
    one.SpeakTo(follower, kBegin);
    const auto value = [&] {
      const Tile* tile = follower.Snapshot()->merged.Find({0, 0});
      return tile == nullptr ? 0 : tile->control_points[0];
    };
    ASSERT_EQ(value(), 100);
    follower.HandleMessage(Decision({"one", 1}, Control(1, true, 0)), kBegin);
    EXPECT_EQ(value(), takes_decisions ? 0 : 100);
    follower.HandleMessage(Decision({"one", 1}, Control(2, false, 1)), kBegin);
    EXPECT_EQ(value(), takes_decisions ? 0 : 100);
    EXPECT_EQ(follower.Layers(kBegin).size(), takes_decisions ? 0u : 1u);
    for (const MapFollower::Message& message : follower.Tick(kBegin + milliseconds(1000))) {
      EXPECT_TRUE(takes_decisions || !std::holds_alternative<control_records_t>(message));
    }
  }
}

TEST(MapFollowerTest, AStartOrARemovalThatNobodyCountsToIsIgnored) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  MapFollower follower({}, 1);
  // Of the removal the follower hears before the layer.
  follower.HandleMessage(Decision({"one", 1}, Control(1, false, 1ull << 61)), kBegin);
  one.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.Snapshot()->layers.size(), 1u);
  follower.HandleMessage(Decision({"one", 1}, Control(1, false, 1ull << 61)), kBegin);
  EXPECT_EQ(follower.Snapshot()->layers.size(), 1u);
  layer_digest_t digest{};
  digest.layer = ToMessage({{"one", 1}, {LayerControl::kMaxStartsAhead + 2, 1}, {}});
  digest.protocol_version = kProtocolVersion;
  digest.knot_interval_m = kOptions.knot_interval_m;
  digest.min_control_point = kOptions.limits.min;
  digest.max_control_point = kOptions.limits.max;
  digest.root_level = 1;
  follower.HandleMessage(Encode(digest), kBegin);
  EXPECT_EQ(follower.malformed(), 1);
  one.SpeakTo(follower, kBegin + milliseconds(1000));
  EXPECT_TRUE(follower.Layers(kBegin + milliseconds(1000))[0].in_sync);
  // A true one is not.
  follower.HandleMessage(Decision({"one", 1}, Control(1, false, 1)), kBegin);
  EXPECT_TRUE(follower.Snapshot()->layers.empty());
}

TEST(MapFollowerTest, ARegionIsOfTheMapFrameAtAnyLevel) {
  Owner one("one", 1);
  one.Commit({0, 0}, 100);
  one.Commit({9, 0}, 100);
  FollowOptions options;
  options.region = Region{0.2, 0.2, 1.4, 1.4};
  MapFollower follower(options, 1);
  one.SpeakTo(follower, kBegin);
  EXPECT_EQ(follower.Snapshot()->layers[0].tiles.size(), 1u);
  EXPECT_EQ(follower.Snapshot()->options, kOptions);

  options.detail = {3, Band::kMax};
  MapFollower coarse(options, 1);
  one.SpeakTo(coarse, kBegin);
  EXPECT_DOUBLE_EQ(coarse.Snapshot()->options.knot_interval_m, 0.4);
  const auto messages = coarse.Tick(kBegin + milliseconds(200));
  ASSERT_EQ(messages.size(), 1u);
  const auto& pull = std::get<layer_pull_t>(messages[0]);
  EXPECT_EQ(pull.layer.detail_level, 3);
  EXPECT_EQ(pull.layer.band, 2);
}

}  // namespace splinemap::map_follower_test
