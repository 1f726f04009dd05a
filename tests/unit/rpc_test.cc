// Queries and answers as messages.
#include <gtest/gtest.h>

#include <limits>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/distances_reply_t.hpp"
#include "lcmtypes/splinemap/distances_request_t.hpp"
#include "lcmtypes/splinemap/likelihoods_reply_t.hpp"
#include "lcmtypes/splinemap/likelihoods_request_t.hpp"
#include "lcmtypes/splinemap/points_reply_t.hpp"
#include "lcmtypes/splinemap/points_request_t.hpp"
#include "lcmtypes/splinemap/raster_reply_t.hpp"
#include "lcmtypes/splinemap/raster_request_t.hpp"
#include "lcmtypes/splinemap/rays_reply_t.hpp"
#include "lcmtypes/splinemap/rays_request_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/sweeps_reply_t.hpp"
#include "lcmtypes/splinemap/sweeps_request_t.hpp"
#include "lib/rpc/answer.h"
#include "lib/rpc/encoded.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "splinemap/local_map.h"
#include "tests/support/queries.h"

namespace splinemap::rpc_test {

reply_t Header() {
  reply_t header{};
  header.id = 5;
  header.name = "robot";
  header.daemon_nonce = 6;
  header.session_number = 7;
  return header;
}

// Rays, sweeps and distances that have answers of their own, before any map has.
class AnyAnswers : public LocalMap {
 public:
  using LocalMap::LocalMap;

  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override {
    if (const auto* rays = std::get_if<const RaysQuery*>(&query)) return AnswerTo(**rays);
    if (const auto* sweeps = std::get_if<const SweepsQuery*>(&query)) return AnswerTo(**sweeps);
    if (const auto* distances = std::get_if<const DistancesQuery*>(&query)) {
      return AnswerTo(**distances);
    }
    return LocalMap::AskAny(query);
  }

 private:
  static RaysQuery::Answer AnswerTo(const RaysQuery& query) {
    RaysQuery::Answer answer{.revision = 3, .ends = {}};
    for (const Ray& ray : query.rays) {
      answer.ends.push_back({ray.bearing_rad > 0 ? Occupancy::kOccupied : Occupancy::kUnknown,
                             ray.max_range_m + ray.origin_m.x() - ray.origin_m.y() +
                                 query.occupied_log_odds + static_cast<double>(query.unknown)});
    }
    return answer;
  }
  static SweepsQuery::Answer AnswerTo(const SweepsQuery& query) {
    SweepsQuery::Answer answer{.revision = 3, .results = {}};
    for (const Sweep& sweep : query.sweeps) {
      answer.results.push_back({Occupancy::kOccupied, sweep.path_m.size() % 2 == 1,
                                sweep.radius_m + static_cast<double>(query.unknown),
                                sweep.path_m.back() + sweep.path_m.front()});
    }
    return answer;
  }
  static DistancesQuery::Answer AnswerTo(const DistancesQuery& query) {
    DistancesQuery::Answer answer{.revision = 3, .distances = {}};
    for (const Eigen::Vector2d& point_m : query.points_m) {
      answer.distances.push_back({query.max_distance_m + query.occupied_log_odds, point_m});
    }
    return answer;
  }
};

class RpcTest : public testing::Test {
 protected:
  // The whole answer as a client puts it together from replies to the pieces.
  template <typename Query>
  typename Query::Answer AskInPieces(const Query& query) {
    typename Query::Answer answer;
    const std::vector<Chunk> pieces = Split(query);
    num_pieces_ = pieces.size();
    for (const Chunk& piece : pieces) {
      request_t header{};
      header.client = -1;
      const std::vector<uint8_t> request = EncodeRequest(query, piece, header);
      EXPECT_LE(request.size(), kMaxRpcBytes);
      const auto decoded = Decode<typename Rpc<Query>::Request>(request);
      EXPECT_TRUE(decoded.ok()) << decoded.status();
      if (!decoded.ok()) return {};
      EXPECT_EQ(decoded->header.client, -1);
      EXPECT_EQ(Encode(*decoded), request);
      const std::vector<uint8_t> bytes = AnswerRequest(request, map_, Header());
      EXPECT_LE(bytes.size(), kMaxRpcBytes);
      const auto reply = Decode<typename Rpc<Query>::Reply>(bytes);
      EXPECT_TRUE(reply.ok()) << reply.status();
      if (!reply.ok()) return {};
      EXPECT_EQ(reply->header.id, 5);
      EXPECT_EQ(reply->header.daemon_nonce, 6);
      EXPECT_TRUE(StatusOf(reply->header).ok()) << StatusOf(reply->header);
      EXPECT_EQ(Encode(*reply), bytes);
      EXPECT_TRUE(HandleReply(bytes, query, piece, answer).ok());
    }
    return answer;
  }

  template <typename Query>
  void ExpectSame(const Query& query, size_t pieces) {
    const auto expected = map_.Ask(query);
    ASSERT_TRUE(expected.ok()) << expected.status();
    EXPECT_TRUE(AreSame(AskInPieces(query), *expected));
    EXPECT_EQ(num_pieces_, pieces);
  }

  // What the map says to a request.
  template <typename Request>
  absl::Status StatusFor(const Request& request) {
    return StatusForBytes(Encode(request));
  }
  absl::Status StatusForBytes(const std::vector<uint8_t>& request) {
    const std::vector<uint8_t> bytes = AnswerRequest(request, map_, Header());
    if (bytes.empty()) return absl::DataLossError("no reply");
    reply_t header;
    // After the fingerprint, which the header does not have.
    EXPECT_GE(header._decodeNoHash(bytes.data(), 8, static_cast<int>(bytes.size()) - 8), 0);
    return StatusOf(header);
  }

  std::mt19937_64 random_{1};
  AnyAnswers map_{RandomMap(1)};
  size_t num_pieces_ = 0;
};

TEST_F(RpcTest, AnswersInPiecesAreThoseInProcess) {
  ExpectSame(RandomPoints(random_, 5000), 3);
  ExpectSame(RandomPoints(random_, 5001), 5);  // with second derivatives
  const RaysQuery rays = RandomRays(random_, 5000);
  ExpectSame(rays, Split(rays).size());
  ExpectSame(RandomRaster(random_, 100'000), 4);
  ExpectSame(RandomLikelihoods(random_, 3000), 3);
  ExpectSame(RandomDistances(random_, 5000), 60);
  SweepsQuery sweeps = RandomSweeps(random_, 2000);
  sweeps.sweeps[7].path_m.resize(Sweep::kMaxVertices, {1, 2});
  const size_t pieces = Split(sweeps).size();
  EXPECT_GT(pieces, 5u);
  ExpectSame(sweeps, pieces);
}

TEST_F(RpcTest, AQueryOfNothingIsOneRequest) {
  ExpectSame(PointsQuery{}, 1);
  ExpectSame(RaysQuery{}, 1);
  ExpectSame(SweepsQuery{}, 1);
  ExpectSame(LikelihoodsQuery{}, 1);
  ExpectSame(DistancesQuery{}, 1);
}

TEST_F(RpcTest, TheLargestItemsFit) {
  SweepsQuery sweeps;
  sweeps.sweeps.resize(20, {std::vector<Eigen::Vector2d>(Sweep::kMaxVertices, {1, 2}), 1});
  ExpectSame(sweeps, 7);
  LikelihoodsQuery scan = RandomLikelihoods(random_, 1000);
  scan.hits_robot_m.resize(LikelihoodsQuery::kMaxHits, {1, 1});
  ExpectSame(scan, 4);
  scan.hits_robot_m.clear();
  ExpectSame(scan, 1);
}

TEST_F(RpcTest, RowsOfARasterMayBeLongerThanAPiece) {
  ExpectSame(RasterQuery{{-1, -2}, 0.01, 100'000, 2}, 7);
  ExpectSame(RasterQuery{{-1, -2}, 0.01, 1, 70'000}, 3);
}

TEST_F(RpcTest, MoreThanAPieceInARequestIsRefusedWithNumbers) {
  const auto expect_refused = [&](const auto& query, const std::string& number) {
    const auto status =
        StatusForBytes(EncodeRequest(query, {0, Split(query).front().end + 1}, request_t()));
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
    EXPECT_NE(std::string(status.message()).find(number), std::string::npos) << status;
  };
  expect_refused(RandomPoints(random_, 5000), "2361 points in one request; 2360 are allowed");
  expect_refused(RandomPoints(random_, 5001), "1205 points in one request; 1204 are allowed");
  RaysQuery rays = RandomRays(random_, 5000);
  for (Ray& ray : rays.rays) ray.max_range_m = 1;
  expect_refused(rays, "1844 rays in one request; 1843 are allowed");
  expect_refused(RandomSweeps(random_, 5000), "sweeps in one request");
  expect_refused(RandomRaster(random_, 60'000), "29501 cells in one request; 29500 are allowed");
  expect_refused(RandomLikelihoods(random_, 5000), "1251 poses for 400 hits in one request; 1250");
  expect_refused(RandomDistances(random_, 5000), "85 points within 2 m in one request; 84 are");
}

TEST_F(RpcTest, MuchWorkIsCutAndMoreThanAPieceOfItRefusedWithNumbers) {
  const auto expect_refused = [&](const auto& query, size_t items, const std::string& numbers) {
    const auto status = StatusFor(ToMessage(query, {0, items}));
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
    EXPECT_NE(std::string(status.message()).find(numbers), std::string::npos) << status;
  };
  RaysQuery rays;
  rays.rays.resize(100, {{0, 0}, 1, 1000});
  ExpectSame(rays, 20);
  expect_refused(rays, 6, "rays of 6000 m in one request; 5000 are allowed");
  rays.rays[1].max_range_m = 1e300;  // one ray may have any length
  rays.rays[50].max_range_m = 1e9;
  ExpectSame(rays, Split(rays).size());
  EXPECT_EQ(Split(rays)[1].size(), 1u);

  DistancesQuery distances = RandomDistances(random_, 10);
  distances.max_distance_m = 100;
  ExpectSame(distances, 10);
  expect_refused(distances, 2, "2 points within 100 m in one request; 1 are allowed");
  auto request = ToMessage(distances, {0, 2});
  for (const double wrong : {std::nan(""), -1e300, -10.0, 1e300}) {
    request.max_distance_m = wrong;
    EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(request))) << wrong;
  }

  SweepsQuery sweeps;
  sweeps.sweeps.resize(40, {{{0, 0}, {1000, 0}}, 1});
  ExpectSame(sweeps, 40);
  expect_refused(sweeps, 2, "of 8032 m2 in one request; 8000 are allowed");
  sweeps.sweeps = {{{{0, 0}, {1000, 0}}, 10}};
  EXPECT_EQ(Split(sweeps).size(), 1u);
  expect_refused(sweeps, 1, "8000 are allowed");
}

TEST_F(RpcTest, WhatNoMapAnswersIsRefused) {
  const double nan = std::nan("");
  RaysQuery rays = RandomRays(random_, 3);
  rays.rays[1].bearing_rad = nan;
  EXPECT_TRUE(absl::IsInvalidArgument(Check(rays)));
  const LocalMap map(RandomMap(1));  // AnyAnswers does not check
  const auto reply =
      Decode<rays_reply_t>(AnswerRequest(Encode(ToMessage(rays, {0, 3})), map, Header()));
  ASSERT_TRUE(reply.ok());
  EXPECT_FALSE(StatusOf(reply->header).ok());
  EXPECT_EQ(reply->num_rays, 0);

  raster_request_t raster = ToMessage(RasterQuery{{0, 0}, 1, 1000, 1000}, {0, 10});
  EXPECT_TRUE(StatusFor(raster).ok());
  raster.width = 1'000'000;  // 10^9 cells
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster)));
  raster.width = std::numeric_limits<int32_t>::max();
  raster.height = std::numeric_limits<int32_t>::max();
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster)));
  raster.width = raster.height = 10;
  raster.first_cell = 91;
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster))) << "beyond the end";
  raster.first_cell = std::numeric_limits<int32_t>::max();
  raster.num_cells = std::numeric_limits<int32_t>::max();
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster)));
  raster.first_cell = -1;
  raster.num_cells = 1;
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster)));
  raster.first_cell = 1;
  raster.num_cells = -1;
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster)));
  raster.num_cells = 1;
  raster.resolution_m = nan;
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(raster)));
  raster.resolution_m = 1e9;  // a box of 10^7 km
  EXPECT_TRUE(StatusFor(raster).ok());

  likelihoods_request_t scan = ToMessage(RandomLikelihoods(random_, 2), {0, 2});
  EXPECT_TRUE(StatusFor(scan).ok());
  scan.yaw_rad[1] = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(scan)));
  scan.yaw_rad[1] = 0;
  scan.num_hits = 3000;
  scan.hit_x_m.resize(3000);
  scan.hit_y_m.resize(3000);
  EXPECT_TRUE(absl::IsInvalidArgument(StatusFor(scan)));
}

TEST_F(RpcTest, RepliesToAnotherPieceAreNotTaken) {
  const PointsQuery query = RandomPoints(random_, 4);
  PointsQuery::Answer answer;
  const std::vector<uint8_t> reply = EncodeReply(*map_.Ask(query), Header());
  EXPECT_FALSE(HandleReply(reply, query, {0, 3}, answer).ok());
  EXPECT_FALSE(HandleReply(reply, {query.points_m, true}, {0, 4}, answer).ok());
  EXPECT_FALSE(
      HandleReply(absl::MakeSpan(reply).first(reply.size() - 1), query, {0, 4}, answer).ok());
  EXPECT_TRUE(answer.samples.empty());
  EXPECT_TRUE(HandleReply(reply, query, {0, 4}, answer).ok());
  reply_t nameless = Header();
  nameless.name.clear();
  EXPECT_FALSE(HandleReply(EncodeReply(*map_.Ask(query), nameless), query, {0, 4}, answer).ok());

  const RaysQuery rays = RandomRays(random_, 2);
  rays_reply_t ends = ToMessage(*map_.Ask(rays));
  ends.occupancy[1] = 3;
  RaysQuery::Answer ends_answer;
  EXPECT_FALSE(HandleReply(ends, rays, {0, 2}, ends_answer).ok());
}

TEST_F(RpcTest, EveryRequestCanBeRefused) {
  const auto refuse = [](const auto& request) {
    return RefuseRequest(Encode(request), absl::ResourceExhaustedError(std::string(10'000, 'x')),
                         Header());
  };
  const auto expect_exhausted = [](const auto& reply) {
    ASSERT_TRUE(reply.ok()) << reply.status();
    EXPECT_TRUE(absl::IsResourceExhausted(StatusOf(reply->header)));
    EXPECT_LT(reply->header.status_text.size(), 1000u);
  };
  expect_exhausted(Decode<points_reply_t>(refuse(points_request_t{})));
  expect_exhausted(Decode<rays_reply_t>(refuse(rays_request_t{})));
  expect_exhausted(Decode<sweeps_reply_t>(refuse(sweeps_request_t{})));
  expect_exhausted(Decode<raster_reply_t>(refuse(raster_request_t{})));
  expect_exhausted(Decode<likelihoods_reply_t>(refuse(likelihoods_request_t{})));
  expect_exhausted(Decode<distances_reply_t>(refuse(distances_request_t{})));
  expect_exhausted(Decode<command_reply_t>(refuse(command_request_t{})));
  EXPECT_TRUE(refuse(points_reply_t{}).empty());
}

}  // namespace splinemap::rpc_test
