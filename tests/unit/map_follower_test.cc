#include "lib/following/map_follower.h"

#include <gtest/gtest.h>

#include <string>
#include <variant>
#include <vector>

#include "lib/map/map.h"
#include "lib/replication/levels_publisher.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

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

}  // namespace
}  // namespace splinemap
