// What all maps that can be asked have in common: in process, a replica, that of a daemon. On a bus
// of its own.
#include "splinemap/queryable_map.h"

#include <gtest/gtest.h>

#include <limits>
#include <thread>

#include "lib/base/random.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/receiving_thread.h"
#include "services/splinemapd/replication_thread.h"
#include "services/splinemapd/request_server.h"
#include "splinemap/client.h"
#include "splinemap/replica.h"
#include "tests/support/queries.h"

namespace splinemap::queryable_map_test {

using std::chrono::milliseconds;

// Serves one map as a daemon does, to clients and followers.
class MapOnBus {
 public:
  explicit MapOnBus(const MapView& map)
      : newest_(map.options, {{"robot", 1}, {1, RandomId()}, map.revision, map.tiles}),
        bus_(*LcmBus::Open("")),
        receiving_(*bus_, notices_),
        replication_(*bus_, {}, Fast(), {.options = map.options}, newest_, notices_),
        requests_("SPLINEMAP", newest_,
                  [this](const std::string& channel, absl::Span<const uint8_t> reply) {
                    bus_->PublishBytes(channel, reply);
                  },
                  {}) {
    for (const std::string& channel : ReplicationChannels("SPLINEMAP")) {
      receiving_.Subscribe(channel, [this](const std::string&, auto m) { replication_.Handle(m); });
    }
    for (const std::string& channel : RequestServer::Channels("SPLINEMAP")) {
      receiving_.Subscribe(channel, [this](const std::string&, auto m) { requests_.Handle(m); });
    }
    replication_.Start({});
    receiving_.Start(requests_);
  }
  ~MapOnBus() {
    requests_.Stop();
    receiving_.Stop();
    replication_.Stop();
  }

 private:
  static PublisherOptions Fast() {
    PublisherOptions options;
    options.bytes_per_s = 1e7;
    return options;
  }

  NewestMap newest_;
  NoticeLog notices_{[](bool, const std::string&) {}};
  std::unique_ptr<LcmBus> bus_;
  ReceivingThread receiving_;
  ReplicationThread replication_;
  RequestServer requests_;
};

enum class Kind { kLocal, kReplica, kClient };

class QueryableMapTest : public testing::TestWithParam<Kind> {
 protected:
  void SetUp() override {
    switch (GetParam()) {
      case Kind::kLocal:
        map_ = std::make_unique<LocalMap>(map_view_);
        break;
      case Kind::kReplica: {
        served_ = std::make_unique<MapOnBus>(*map_view_);
        auto replica = *MapReplica::Follow("", {});
        // What it has received it shows a moment later.
        const auto is_caught_up = [&] {
          const auto layers = replica->FollowedLayers();
          return layers.size() == 1 && layers[0].matches_digest &&
                 replica->View()->tiles.size() == map_view_->tiles.size();
        };
        const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20);
        while (!is_caught_up() && std::chrono::steady_clock::now() < deadline) {
          std::this_thread::sleep_for(milliseconds(10));
        }
        ASSERT_TRUE(is_caught_up());
        map_ = std::move(replica);
        break;
      }
      case Kind::kClient: {
        served_ = std::make_unique<MapOnBus>(*map_view_);
        ClientOptions options;
        options.deadline = std::chrono::seconds(20);
        auto client = MapClient::Connect("", options);
        ASSERT_TRUE(client.ok()) << client.status();
        map_ = *std::move(client);
        break;
      }
    }
  }

  template <typename Query>
  void ExpectSame(const Query& query) {
    const auto expected = LocalMap(map_view_).Ask(query);
    const auto answer = map_->Ask(query);
    EXPECT_EQ(answer.status(), expected.status());
    if (expected.ok() && answer.ok()) {
      EXPECT_TRUE(AreSame(*answer, *expected));
      EXPECT_EQ(answer->revision, 20u);
    }
  }

  template <typename Query>
  void ExpectInvalid(const Query& query) {
    const auto status = map_->Ask(query).status();
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
    EXPECT_EQ(status, Check(query));
  }

  std::mt19937_64 random_{3};
  const std::shared_ptr<const MapView> map_view_ = RandomMap(1);
  std::unique_ptr<MapOnBus> served_;
  std::unique_ptr<QueryableMap> map_;
};

TEST_P(QueryableMapTest, AnswersAreThoseOfTheMapInProcess) {
  for (const size_t size : {1, 2, 100, 777}) {
    ExpectSame(RandomPoints(random_, size));
    ExpectSame(RandomRays(random_, size));
    ExpectSame(RandomSweeps(random_, size));
    ExpectSame(RandomRaster(random_, size));
    ExpectSame(RandomLikelihoods(random_, size));
    ExpectSame(RandomDistances(random_, size));
  }
}

TEST_P(QueryableMapTest, LargeQueriesToo) {
  ExpectSame(RandomPoints(random_, 100'001));
  ExpectSame(RandomRays(random_, 10'000));
  ExpectSame(RandomSweeps(random_, 2'000));
  ExpectSame(RandomRaster(random_, 1'000'000));
  ExpectSame(RandomLikelihoods(random_, 3'000));
  ExpectSame(RandomDistances(random_, 20'000));
}

TEST_P(QueryableMapTest, NothingIsAskedAndAnsweredWithARevision) {
  ExpectSame(PointsQuery{});
  ExpectSame(RaysQuery{});
  ExpectSame(SweepsQuery{});
  ExpectSame(LikelihoodsQuery{});
  ExpectSame(DistancesQuery{});
}

TEST_P(QueryableMapTest, FarAwayNothingIsKnown) {
  ExpectSame(PointsQuery{{{1e9, -1e9}, {std::nan(""), 0}}, true});
  ExpectSame(RasterQuery{{-1e9, -1e9}, 1e7, 200, 200});
  ExpectSame(LikelihoodsQuery{{{1e9, 0}, {0, 1}}, {{{1e9, 1e9}, 1}}});
}

TEST_P(QueryableMapTest, WhatNoMapAnswersIsRefusedWithItsPlace) {
  const double nan = std::nan("");
  ExpectInvalid(RaysQuery{{{{0, 0}, 0, 1}, {{nan, 0}, 0, 1}}});
  ExpectInvalid(RaysQuery{{{{0, 0}, 0, -1}}});
  ExpectInvalid(RaysQuery{{}, nan});
  ExpectInvalid(RaysQuery{{}, 0, static_cast<UnknownPolicy>(2)});
  ExpectInvalid(SweepsQuery{{{{}, 1}}});
  ExpectInvalid(SweepsQuery{{{{{0, 0}}, -1}}});
  ExpectInvalid(SweepsQuery{{{{{0, 0}, {nan, 0}}, 1}}});
  ExpectInvalid(SweepsQuery{{{std::vector<Eigen::Vector2d>(Sweep::kMaxVertices + 1), 1}}});
  ExpectInvalid(RasterQuery{{0, 0}, 0, 1, 1});
  ExpectInvalid(RasterQuery{{0, 0}, 0.1, 0, 1});
  ExpectInvalid(RasterQuery{{0, 0}, 0.1, 1'000'000, 1'000});
  ExpectInvalid(LikelihoodsQuery{{{nan, 0}}, {}});
  ExpectInvalid(LikelihoodsQuery{{}, {{{0, 0}, std::numeric_limits<double>::infinity()}}});
  ExpectInvalid(LikelihoodsQuery{std::vector<Eigen::Vector2d>(LikelihoodsQuery::kMaxHits + 1), {}});
  ExpectInvalid(DistancesQuery{{{0, nan}}});
  ExpectInvalid(DistancesQuery{{}, 1000});
}

std::string KindName(const testing::TestParamInfo<Kind>& kind) {
  switch (kind.param) {
    case Kind::kLocal:
      return "Local";
    case Kind::kReplica:
      return "Replica";
    case Kind::kClient:
      return "Client";
  }
  return "";
}

INSTANTIATE_TEST_SUITE_P(All, QueryableMapTest,
                         testing::Values(Kind::kLocal, Kind::kReplica, Kind::kClient), KindName);

}  // namespace splinemap::queryable_map_test
