#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
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
#include "lcmtypes/splinemap/request_t.hpp"
#include "lcmtypes/splinemap/sweeps_reply_t.hpp"
#include "lcmtypes/splinemap/sweeps_request_t.hpp"
#include "splinemap/queries.h"

// Queries and their answers as messages; lcmtypes/ASKING.md describes how a map is asked. Requests
// for points and replies to them: points_in_place.h.

namespace splinemap {

// Of a request or reply: one LCM datagram, whatever its kind.
inline constexpr size_t kMaxRpcBytes = 60'000;
// For how long requests of one query are answered from one state of the map.
inline constexpr std::chrono::seconds kPinTime(10);

// Where a client hears the replies to it.
std::string ReplyChannel(const std::string& channel_prefix, uint64_t client);

absl::Status StatusOf(const reply_t& header);
// Texts are cut where they would not fit.
void SetStatus(const absl::Status& status, reply_t& header);

// The messages of a query, how people call it, and what the channel of its requests ends in.
template <typename Query>
struct Rpc;
template <>
struct Rpc<PointsQuery> {
  using Request = points_request_t;
  using Reply = points_reply_t;
  static constexpr const char* kName = "points";
  static constexpr const char* kChannel = "_POINTS_REQUESTS";
};
template <>
struct Rpc<RaysQuery> {
  using Request = rays_request_t;
  using Reply = rays_reply_t;
  static constexpr const char* kName = "rays";
  static constexpr const char* kChannel = "_RAYS_REQUESTS";
};
template <>
struct Rpc<SweepsQuery> {
  using Request = sweeps_request_t;
  using Reply = sweeps_reply_t;
  static constexpr const char* kName = "sweeps";
  static constexpr const char* kChannel = "_SWEEPS_REQUESTS";
};
template <>
struct Rpc<RasterQuery> {
  using Request = raster_request_t;
  using Reply = raster_reply_t;
  static constexpr const char* kName = "cells";
  static constexpr const char* kChannel = "_RASTER_REQUESTS";
};
template <>
struct Rpc<LikelihoodsQuery> {
  using Request = likelihoods_request_t;
  using Reply = likelihoods_reply_t;
  static constexpr const char* kName = "poses";
  static constexpr const char* kChannel = "_LIKELIHOODS_REQUESTS";
};
template <>
struct Rpc<DistancesQuery> {
  using Request = distances_request_t;
  using Reply = distances_reply_t;
  static constexpr const char* kName = "points";
  static constexpr const char* kChannel = "_DISTANCES_REQUESTS";
};
inline constexpr const char* kCommandChannel = "_COMMAND_REQUESTS";

// Items [begin, end) of a query: points, rays, sweeps, cells, poses.
struct Chunk {
  size_t begin = 0;
  size_t end = 0;

  size_t size() const { return end - begin; }
};

// Chunks whose requests and replies are messages of kMaxRpcBytes at most, and quickly answered; one
// for a query of nothing. A sweep that alone is too much work is refused by the daemon. Requires
// Check(query).ok().
std::vector<Chunk> Split(const PointsQuery& query);
std::vector<Chunk> Split(const RaysQuery& query);
std::vector<Chunk> Split(const SweepsQuery& query);
std::vector<Chunk> Split(const RasterQuery& query);
std::vector<Chunk> Split(const LikelihoodsQuery& query);
std::vector<Chunk> Split(const DistancesQuery& query);

// A client asks for a chunk.
rays_request_t ToMessage(const RaysQuery& query, Chunk chunk);
sweeps_request_t ToMessage(const SweepsQuery& query, Chunk chunk);
raster_request_t ToMessage(const RasterQuery& query, Chunk chunk);
likelihoods_request_t ToMessage(const LikelihoodsQuery& query, Chunk chunk);
distances_request_t ToMessage(const DistancesQuery& query, Chunk chunk);

// InvalidArgument for more points than a chunk has.
absl::Status CheckNumPoints(size_t num_points, bool with_hessians);
// What a decoded request asks for. InvalidArgument where it is more than a chunk; Check() is the
// map's.
absl::StatusOr<RaysQuery> FromMessage(const rays_request_t& request);
absl::StatusOr<SweepsQuery> FromMessage(const sweeps_request_t& request);
absl::StatusOr<LikelihoodsQuery> FromMessage(const likelihoods_request_t& request);
absl::StatusOr<DistancesQuery> FromMessage(const distances_request_t& request);
struct RasterPart {
  RasterQuery raster;
  Chunk cells;
};
absl::StatusOr<RasterPart> FromMessage(const raster_request_t& request);

// A daemon replies. Heads are the caller's, but for `revision`.
rays_reply_t ToMessage(const RaysQuery::Answer& answer);
sweeps_reply_t ToMessage(const SweepsQuery::Answer& answer);
raster_reply_t ToMessage(const RasterQuery::Answer& answer);
likelihoods_reply_t ToMessage(const LikelihoodsQuery::Answer& answer);
distances_reply_t ToMessage(const DistancesQuery::Answer& answer);

// Puts the decoded reply to a chunk where it belongs. InvalidArgument, and the answer is unchanged,
// where it does not answer that chunk.
absl::Status HandleReply(const rays_reply_t& reply, const RaysQuery& query, Chunk chunk,
                         RaysQuery::Answer& answer);
absl::Status HandleReply(const sweeps_reply_t& reply, const SweepsQuery& query, Chunk chunk,
                         SweepsQuery::Answer& answer);
absl::Status HandleReply(const raster_reply_t& reply, const RasterQuery& query, Chunk chunk,
                         RasterQuery::Answer& answer);
absl::Status HandleReply(const likelihoods_reply_t& reply, const LikelihoodsQuery& query,
                         Chunk chunk, LikelihoodsQuery::Answer& answer);
absl::Status HandleReply(const distances_reply_t& reply, const DistancesQuery& query, Chunk chunk,
                         DistancesQuery::Answer& answer);

}  // namespace splinemap
