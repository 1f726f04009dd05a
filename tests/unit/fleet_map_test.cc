#include "lib/fleet/fleet_map.h"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <memory>
#include <random>
#include <thread>
#include <vector>

#include "lib/base/status.h"
#include "lib/fleet/answer_query.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/query_records.h"
#include "lib/fleet/query_tiles.h"
#include "splinemap/local_map.h"
#include "tests/support/map_writer.h"
#include "tests/support/queries.h"
#include "tests/support/random_map.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

constexpr double kSquare_m = 32 * 32 * 0.05;
// Corners of squares, around which the map has tiles.
const std::vector<Eigen::Vector2i> kCorners = {{0, 0}, {1, 0}, {-1, 1}, {2, -1}, {9, -7}};

std::shared_ptr<const MapView> WideMap(uint64_t seed) {
  std::mt19937_64 random(seed);
  MapWriter map({0.05, {-2560, 2560}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  for (const Eigen::Vector2i& corner : kCorners) {
    layer.BeginCommit();
    for (int k = 0; k < 60; ++k) {
      const TileKey near = RandomKey(random, 6);
      layer.EditTile({near.tx + 32 * corner.x(), near.ty + 32 * corner.y()}) =
          RandomTile(random, map.options().limits);
    }
  }
  return map.View();
}

Eigen::Vector2d CornerOf(std::mt19937_64& random) {
  return kSquare_m * kCorners[random() % kCorners.size()].cast<double>();
}

// Queries of support/queries.h, and longer ones, around corners of squares.

PointsQuery WidePoints(std::mt19937_64& random, size_t size) {
  PointsQuery query = RandomPoints(random, size);
  for (Eigen::Vector2d& point_m : query.points_m) point_m += CornerOf(random);
  if (size > 3) query.points_m[2] = {std::nan(""), 0};
  return query;
}

RaysQuery WideRays(std::mt19937_64& random, size_t size) {
  RaysQuery query = RandomRays(random, size);
  for (Ray& ray : query.rays) {
    ray.origin_m += CornerOf(random);
    if (random() % 8 == 0) ray.max_range_m *= 10;
    if (random() % 8 == 0) ray.bearing_rad = static_cast<double>(random() % 4) * M_PI / 2;
  }
  return query;
}

SweepsQuery WideSweeps(std::mt19937_64& random, size_t size) {
  SweepsQuery query = RandomSweeps(random, size);
  for (Sweep& sweep : query.sweeps) {
    const Eigen::Vector2d shift_m = CornerOf(random);
    for (Eigen::Vector2d& vertex_m : sweep.path_m) vertex_m += shift_m;
    // From far outside, over the map, and on.
    if (random() % 4 == 0) {
      sweep.path_m.insert(sweep.path_m.begin(), shift_m + Eigen::Vector2d(-37.3, 23.1));
    }
    if (random() % 4 == 0) sweep.path_m.push_back(shift_m + Eigen::Vector2d(91.7, -13.9));
    if (random() % 8 == 0) sweep.radius_m *= 10;
  }
  return query;
}

RasterQuery WideRaster(std::mt19937_64& random, size_t size) {
  RasterQuery query = RandomRaster(random, size);
  query.first_m += CornerOf(random);
  if (random() % 3 == 0) query.resolution_m *= 7;
  return query;
}

LikelihoodsQuery WideLikelihoods(std::mt19937_64& random, size_t size) {
  LikelihoodsQuery query = RandomLikelihoods(random, size);
  for (Pose2& pose : query.world_T_robot) pose.position_m += CornerOf(random);
  return query;
}

DistancesQuery WideDistances(std::mt19937_64& random, size_t size) {
  DistancesQuery query = RandomDistances(random, size);
  for (Eigen::Vector2d& point_m : query.points_m) point_m += CornerOf(random);
  if (size % 3 == 0) query.max_distance_m = 15;
  return query;
}

// Workers that have some parts of a map each, and nothing else of it.
class Workers {
 public:
  static constexpr size_t kWorkers = 3;

  explicit Workers(const std::shared_ptr<const MapView>& map) : options_(map->options) {
    for (size_t worker = 0; worker < kWorkers; ++worker) {
      // All but a third: each part has two owners.
      for (size_t part = 0; part < kParts; ++part) parts_[worker][part] = part % kWorkers != worker;
      auto view = std::make_shared<MapView>();
      view->options = map->options;
      view->revision = map->revision;
      TileTreeEditor tiles;
      map->tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
        if (parts_[worker][static_cast<size_t>(PartOf(key))]) tiles.Put(key, entry.tile, 1);
      });
      view->tiles = tiles.Freeze();
      maps_[worker] = std::make_unique<LocalMap>(view);
    }
  }

  FleetMap Map(milliseconds deadline = milliseconds(30'000)) {
    const auto ask = [this](int part, const std::string& request,
                            milliseconds) -> absl::StatusOr<std::string> {
      const size_t asked = requests++;
      EXPECT_LT(request.size(), 1u << 20);
      if (asked % 97 == 5) return absl::DeadlineExceededError("it was killed");
      // Now and then one that does not have the part.
      size_t worker = asked % 53 == 7 ? static_cast<size_t>(part) % kWorkers
                                      : (static_cast<size_t>(part) + 1 + asked % 2) % kWorkers;
      if (is_dead_[worker]) return Unavailable("nobody is there");
      const std::string reply = AnswerQuery(request, *maps_[worker], parts_[worker]);
      EXPECT_LT(reply.size(), 1u << 20);
      return reply;
    };
    return {options_, ask, deadline};
  }
  void Kill(size_t worker) { is_dead_[worker] = true; }

  std::atomic<size_t> requests{0};

 private:
  const MapOptions options_;
  std::array<PartSet, kWorkers> parts_;
  std::array<std::unique_ptr<LocalMap>, kWorkers> maps_;
  std::array<std::atomic<bool>, kWorkers> is_dead_{};
};

template <typename Query>
void ExpectSame(const QueryableMap& fleet, const QueryableMap& whole, const Query& query) {
  const auto expected = whole.Ask(query);
  ASSERT_TRUE(expected.ok()) << expected.status();
  const auto found = fleet.Ask(query);
  ASSERT_TRUE(found.ok()) << found.status();
  EXPECT_TRUE(AreSame(*found, *expected));
}

TEST(FleetMapTest, AnswersAreThoseOfTheWholeMapToTheLastBit) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    const auto view = WideMap(seed);
    const LocalMap whole(view);
    Workers workers(view);
    const FleetMap fleet = workers.Map();
    std::mt19937_64 random(seed);
    for (const size_t size : {0, 1, 2, 3, 40, 41}) {
      SCOPED_TRACE(size);
      ExpectSame(fleet, whole, WidePoints(random, size));
      ExpectSame(fleet, whole, WideRays(random, size));
      ExpectSame(fleet, whole, WideSweeps(random, size));
      ExpectSame(fleet, whole, WideRaster(random, 50 * size));
      ExpectSame(fleet, whole, WideLikelihoods(random, size));
      ExpectSame(fleet, whole, WideDistances(random, size));
    }
    ExpectSame(fleet, whole, WidePoints(random, 10'000));
    ExpectSame(fleet, whole, WideRaster(random, 200'000));
  }
}

// Where a way begins beyond all that a map has, the part of it that is looked at does not depend on
// what else the map has.
TEST(FleetMapTest, WaysFromOutsideOfTheMapAreThoseOfTheWholeMap) {
  const auto view = WideMap(4);
  const LocalMap whole(view);
  Workers workers(view);
  const FleetMap fleet = workers.Map();
  std::mt19937_64 random(4);
  // One by one, so that the tiles of the others are not there.
  for (int k = 0; k < 100; ++k) {
    const Eigen::Vector2d to_m = CornerOf(random) + Eigen::Vector2d::Random() * 8;
    const Eigen::Vector2d from_m = to_m + Eigen::Vector2d::Random() * 90;
    const Eigen::Vector2d way_m = to_m - from_m;
    ExpectSame(fleet, whole, SweepsQuery{{{{from_m, to_m}, 0.1}}, 0, UnknownPolicy::kFree});
    ExpectSame(
        fleet, whole,
        RaysQuery{
            {{from_m, std::atan2(way_m.y(), way_m.x()), way_m.norm()}}, 0, UnknownPolicy::kFree});
  }
}

TEST(FleetMapTest, AnswersGoOnWithoutOneOfTwoOwners) {
  const auto view = WideMap(1);
  const LocalMap whole(view);
  Workers workers(view);
  const FleetMap fleet = workers.Map();
  workers.Kill(1);
  std::mt19937_64 random(7);
  ExpectSame(fleet, whole, WideRays(random, 20));
}

TEST(FleetMapTest, WithoutWorkersItIsUnavailableAtTheDeadline) {
  const auto view = WideMap(1);
  Workers workers(view);
  for (const size_t worker : {0, 1, 2}) workers.Kill(worker);
  const FleetMap fleet = workers.Map(milliseconds(250));
  const auto start = std::chrono::steady_clock::now();
  EXPECT_TRUE(absl::IsUnavailable(fleet.Ask(PointsQuery{{{1, 1}}}).status()));
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(5));
  EXPECT_GE(workers.requests, 2u);
}

TEST(FleetMapTest, WhatTakesTooManyTilesIsRefused) {
  const auto view = WideMap(1);
  Workers workers(view);
  const FleetMap fleet = workers.Map();
  const RaysQuery far{{{{0, 0}, 0.3, 1e300}}};
  EXPECT_TRUE(absl::IsInvalidArgument(fleet.Ask(far).status()));
  const RaysQuery long_one{{{{0, 0}, 0.3, 80'000}}};
  EXPECT_TRUE(absl::IsInvalidArgument(fleet.Ask(long_one).status()));
  const LikelihoodsQuery wide{{{-400, 0}, {400, 400}}, {{{0, 0}, 0}}};
  EXPECT_TRUE(absl::IsInvalidArgument(fleet.Ask(wide).status()));
  EXPECT_EQ(workers.requests, 0u);
  // What no map answers is refused as by any other.
  EXPECT_TRUE(absl::IsInvalidArgument(fleet.Ask(DistancesQuery{{{0, 0}}, -1}).status()));
}

TEST(FleetMapTest, AMapOfAnotherKnotIntervalIsNoticed) {
  Workers workers(WideMap(1));
  const FleetMap other(
      {0.1, {-2560, 2560}},
      [&](int, const std::string& request, milliseconds) -> absl::StatusOr<std::string> {
        return AnswerQuery(request, LocalMap(WideMap(1)), PartSet().set());
      },
      milliseconds(1000));
  EXPECT_EQ(other.Ask(PointsQuery{{{1, 1}}}).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

// What a worker does with bytes.

TEST(AnswerQueryTest, OnlyWhatLiesInItsPartsIsAnswered) {
  const LocalMap map(WideMap(1));
  const DistancesQuery query{{{kSquare_m / 2, kSquare_m / 2}}, 2};  // in part 0
  const FleetQueries::Any any = &query;
  const std::string request = EncodeRequest(any, 0.05);
  EXPECT_TRUE(DecodeReply(AnswerQuery(request, map, PartSet(1)), any).ok());
  EXPECT_TRUE(
      absl::IsUnavailable(DecodeReply(AnswerQuery(request, map, ~PartSet(1)), any).status()));
  // It reaches over the border of the part: everywhere in the square it is answered or refused.
  const DistancesQuery across{{{1, kSquare_m / 2}}, 2};
  const FleetQueries::Any any_across = &across;
  const std::string at_border = EncodeRequest(any_across, 0.05);
  EXPECT_TRUE(absl::IsUnavailable(
      DecodeReply(AnswerQuery(at_border, map, PartSet(1)), any_across).status()));
}

template <typename Query>
std::string RequestOf(const Query& query) {
  return EncodeRequest(&query, 0.05);
}

TEST(AnswerQueryTest, HostileRequestsAreRefused) {
  const LocalMap map(WideMap(1));
  const PartSet all = PartSet().set();
  const auto code = [&](const std::string& request) {
    static const BlocksQuery kNothing;
    return DecodeReply(AnswerQuery(request, map, all), &kNothing).status().code();
  };
  using Code = absl::StatusCode;
  EXPECT_EQ(code(""), Code::kInvalidArgument);
  EXPECT_EQ(code("nonsense"), Code::kInvalidArgument);
  const double nan = std::nan("");
  EXPECT_EQ(code(RequestOf(RaysQuery{{{{nan, 0}, 0, 1}}})), Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(DistancesQuery{{{0, 0}}, 1e9})), Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(SweepsQuery{{{{}, 0.1}}})), Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(RaysQuery{{{{0, 0}, 0, 1}}, 0, UnknownPolicy{5}})),
            Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(LikelihoodsQuery{std::vector<Eigen::Vector2d>(2001, {0, 0}), {}})),
            Code::kInvalidArgument);
  // More than one request may ask.
  EXPECT_EQ(code(RequestOf(PointsQuery{std::vector<Eigen::Vector2d>(50'000, {0, 0})})),
            Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(DistancesQuery{std::vector<Eigen::Vector2d>(500, {0, 0}), 100})),
            Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(BlocksQuery{std::vector<BlockKey>(25)})), Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(BlocksQuery{{{1 << 30, 0}}})), Code::kInvalidArgument);
  const RasterQuery raster{{0, 0}, 0.01, 1 << 14, 1 << 14};
  EXPECT_EQ(code(RequestOf(RasterCells{raster, {{0, 0, 1 << 14, 1 << 14}}})),
            Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(RasterCells{raster, {{5, 0, 4, 1}}})), Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(RasterCells{raster, {{0, 0, (1 << 14) + 1, 1}}})),
            Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(RasterCells{raster, {{-1, 0, 1, 1}}})), Code::kInvalidArgument);
  EXPECT_EQ(code(RequestOf(PointsQuery{{{0, 0}}})), Code::kOk);
}

TEST(AnswerQueryTest, ChangedBytesDoNoHarm) {
  const LocalMap map(WideMap(1));
  std::mt19937_64 random(1);
  const std::vector<std::string> requests = {
      RequestOf(WidePoints(random, 5)),
      RequestOf(WideRays(random, 5)),
      RequestOf(WideSweeps(random, 3)),
      RequestOf(WideLikelihoods(random, 2)),
      RequestOf(WideDistances(random, 5)),
      RequestOf(BlocksQuery{{{0, 0}, {1, 1}}}),
      RequestOf(RasterCells{WideRaster(random, 50), {{0, 0, 1, 1}}})};
  const BlocksQuery nothing;
  for (int k = 0; k < 3000; ++k) {
    std::string request = requests[random() % requests.size()];
    for (size_t changes = 1 + random() % 3; changes > 0; --changes) {
      request[random() % request.size()] = static_cast<char>(random());
    }
    if (k % 5 == 0) request.resize(random() % request.size());
    std::string reply = AnswerQuery(request, map, PartSet().set());
    EXPECT_LT(reply.size(), 1u << 20);
    // And the client with a reply.
    if (!reply.empty()) reply[random() % reply.size()] = static_cast<char>(random());
    DecodeReply(reply, &nothing).IgnoreError();
  }
}

TEST(AnswerQueryTest, DamagedRepliesAreNoAnswers) {
  const PointsQuery query{{{1, 1}, {2, 2}}};
  const FleetQueries::Any any = &query;
  EXPECT_TRUE(absl::IsDataLoss(DecodeReply("nonsense", any).status()));
  // Fewer than were asked for, and what is no number.
  PointsQuery::Answer few;
  few.samples.resize(1);
  EXPECT_TRUE(absl::IsDataLoss(DecodeReply(EncodeReply(few), any).status()));
  PointsQuery::Answer wrong;
  wrong.samples.resize(2);
  wrong.samples[1].log_odds = std::nan("");
  EXPECT_TRUE(absl::IsDataLoss(DecodeReply(EncodeReply(wrong), any).status()));
  wrong.samples[1].log_odds = 1;
  EXPECT_TRUE(DecodeReply(EncodeReply(wrong), any).ok());
}

}  // namespace
}  // namespace splinemap
