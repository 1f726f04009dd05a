#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/query/queries.h"
#include "lib/wire/decode.h"

// Queries and their answers as messages; lcmtypes/README.md describes in words how a map is asked.

namespace splinemap {

// Of a request or reply: one LCM datagram, whatever its kind.
inline constexpr size_t kMaxRpcBytes = 60'000;
// For how long requests of one query are answered from one state of the map.
inline constexpr std::chrono::seconds kPinTime(10);

// Where a client hears the replies to it.
std::string ReplyChannel(const std::string& channel_prefix, uint64_t client);

absl::Status StatusOf(const reply_t& head);
// Texts are cut where they would not fit.
void SetStatus(const absl::Status& status, reply_t& head);

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
struct Piece {
  size_t begin = 0;
  size_t end = 0;

  size_t size() const { return end - begin; }
};

// Pieces whose requests and replies are messages of kMaxRpcBytes at most, and quickly answered; one
// for a query of nothing. A sweep that alone is too much work is refused by the daemon. Requires
// Check(query).ok().
std::vector<Piece> Cut(const PointsQuery& query);
std::vector<Piece> Cut(const RaysQuery& query);
std::vector<Piece> Cut(const SweepsQuery& query);
std::vector<Piece> Cut(const RasterQuery& query);
std::vector<Piece> Cut(const LikelihoodsQuery& query);
std::vector<Piece> Cut(const DistancesQuery& query);

// A client asks for a piece.
points_request_t ToMessage(const PointsQuery& query, Piece piece);
rays_request_t ToMessage(const RaysQuery& query, Piece piece);
sweeps_request_t ToMessage(const SweepsQuery& query, Piece piece);
raster_request_t ToMessage(const RasterQuery& query, Piece piece);
likelihoods_request_t ToMessage(const LikelihoodsQuery& query, Piece piece);
distances_request_t ToMessage(const DistancesQuery& query, Piece piece);

// What a decoded request asks for. InvalidArgument where it is more than a piece; Check() is the
// map's.
absl::StatusOr<PointsQuery> FromMessage(const points_request_t& request);
absl::StatusOr<RaysQuery> FromMessage(const rays_request_t& request);
absl::StatusOr<SweepsQuery> FromMessage(const sweeps_request_t& request);
absl::StatusOr<LikelihoodsQuery> FromMessage(const likelihoods_request_t& request);
absl::StatusOr<DistancesQuery> FromMessage(const distances_request_t& request);
struct RasterPart {
  RasterQuery raster;
  Piece cells;
};
absl::StatusOr<RasterPart> FromMessage(const raster_request_t& request);

// A daemon replies. Heads are the caller's, but for `revision`.
points_reply_t ToMessage(const PointsQuery::Answer& answer);
rays_reply_t ToMessage(const RaysQuery::Answer& answer);
sweeps_reply_t ToMessage(const SweepsQuery::Answer& answer);
raster_reply_t ToMessage(const RasterQuery::Answer& answer);
likelihoods_reply_t ToMessage(const LikelihoodsQuery::Answer& answer);
distances_reply_t ToMessage(const DistancesQuery::Answer& answer);

// Puts the decoded reply to a piece where it belongs. InvalidArgument, and the answer is unchanged,
// where it does not answer that piece.
absl::Status TakeReply(const points_reply_t& reply, const PointsQuery& query, Piece piece,
                       PointsQuery::Answer& answer);
absl::Status TakeReply(const rays_reply_t& reply, const RaysQuery& query, Piece piece,
                       RaysQuery::Answer& answer);
absl::Status TakeReply(const sweeps_reply_t& reply, const SweepsQuery& query, Piece piece,
                       SweepsQuery::Answer& answer);
absl::Status TakeReply(const raster_reply_t& reply, const RasterQuery& query, Piece piece,
                       RasterQuery::Answer& answer);
absl::Status TakeReply(const likelihoods_reply_t& reply, const LikelihoodsQuery& query, Piece piece,
                       LikelihoodsQuery::Answer& answer);
absl::Status TakeReply(const distances_reply_t& reply, const DistancesQuery& query, Piece piece,
                       DistancesQuery::Answer& answer);

}  // namespace splinemap
