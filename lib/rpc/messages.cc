#include "lib/rpc/messages.h"

#include <algorithm>

#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/sweep_t.hpp"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

// What heads, counts and single numbers take at most: a name of 256 bytes, and no text of a status
// where there are items.
constexpr size_t kMaxItemBytes = kMaxRpcBytes - 1000;
constexpr size_t kMaxStatusText = 600;
// Work of one request, so that it does not keep the daemon from others for long: some 50 ms at a
// knot interval of 0.05 m over a very rugged surface (tests/bench/serving measures it).
constexpr size_t kMaxHitsAtPoses = 500'000;
constexpr double kMaxLengthOfRays_m = 5'000;
constexpr double kMaxSweptArea_m2 = 8'000;
constexpr double kMaxSearchedArea_m2 = 12'100;

constexpr size_t kRayBytes = 4 * 8;
constexpr size_t kDistanceBytes = 3 * 8;

size_t PointBytes(bool with_hessians) { return 3 * 8 + 1 + (with_hessians ? 3 * 8 : 0); }

size_t SweepBytes(size_t num_vertices) {
  constexpr size_t kResultBytes = 2 + 3 * 8;
  return std::max(8 + 4 + 2 * 8 * num_vertices, kResultBytes);
}

constexpr size_t kMaxCellsOfChunk = kMaxItemBytes / 2;

// Of poses; 0 where the hits alone are too many.
size_t MaxPoses(size_t num_hits) {
  if (num_hits > LikelihoodsQuery::kMaxHits) return 0;
  return std::min((kMaxItemBytes - 2 * 8 * num_hits) / (3 * 8),
                  kMaxHitsAtPoses / std::max<size_t>(num_hits, 1));
}

// One ray may have any length: it ends with the map.
double Work(const Ray& ray) { return std::min(ray.max_range_m, kMaxLengthOfRays_m); }

// The area of the sweep and a metre around it.
double Work(const Sweep& sweep) {
  double length_m = 0;
  for (size_t k = 1; k < sweep.path_m.size(); ++k) {
    length_m += (sweep.path_m[k] - sweep.path_m[k - 1]).norm();
  }
  const double width_m = 2 * (sweep.radius_m + 1);
  return (length_m + width_m) * width_m;
}

// One at the greatest distance.
size_t MaxDistances(double max_distance_m) {
  constexpr double kGreatest_m = DistancesQuery::kMaxDistance_m;
  const bool is_valid = max_distance_m >= 0 && max_distance_m <= kGreatest_m;
  const double reach_m = (is_valid ? max_distance_m : kGreatest_m) + 10;
  return std::min(kMaxItemBytes / kDistanceBytes,
                  static_cast<size_t>(kMaxSearchedArea_m2 / (reach_m * reach_m)));
}

// Chunks of so many bytes and so much work; those of one item may be more.
template <typename Item, typename BytesOf>
std::vector<Chunk> SplitByWork(const std::vector<Item>& items, double max_work, BytesOf bytes_of) {
  std::vector<Chunk> chunks{{0, 0}};
  size_t bytes = 0;
  double work = 0;
  for (const Item& item : items) {
    bytes += bytes_of(item);
    work += Work(item);
    if (chunks.back().size() > 0 && (bytes > kMaxItemBytes || work > max_work)) {
      chunks.push_back({chunks.back().end, chunks.back().end});
      bytes = bytes_of(item);
      work = Work(item);
    }
    ++chunks.back().end;
  }
  return chunks;
}

template <typename Item>
absl::Status CheckWork(const std::vector<Item>& items, double max_work, const char* of,
                       const char* unit) {
  double work = 0;
  for (const Item& item : items) work += Work(item);
  if (!(work > max_work)) return absl::OkStatus();
  return InvalidArgument("{} of {:g} {} in one request; {:g} are allowed", of, work, unit,
                         max_work);
}

std::vector<Chunk> CutEvenly(size_t num_items, size_t max_items) {
  std::vector<Chunk> chunks{{0, std::min(num_items, max_items)}};
  while (chunks.back().end < num_items) {
    const size_t begin = chunks.back().end;
    chunks.push_back({begin, std::min(num_items, begin + max_items)});
  }
  return chunks;
}

absl::Status CheckSize(size_t num_items, size_t max_items, const char* name) {
  if (num_items <= max_items) return absl::OkStatus();
  return InvalidArgument(
      "{} {} in one request; {} are allowed, so that request and reply fit {} bytes", num_items,
      name, max_items, kMaxRpcBytes);
}

std::vector<Eigen::Vector2d> Points(const std::vector<double>& x_m,
                                    const std::vector<double>& y_m) {
  std::vector<Eigen::Vector2d> points_m(x_m.size());
  for (size_t k = 0; k < x_m.size(); ++k) points_m[k] = {x_m[k], y_m[k]};
  return points_m;
}

absl::Status CheckReply(int32_t num_items, Chunk chunk) {
  if (static_cast<size_t>(num_items) == chunk.size()) return absl::OkStatus();
  return InvalidArgument("a reply of {} items to a request of {}", num_items, chunk.size());
}

bool AreOccupancies(const std::vector<int8_t>& values) {
  return std::all_of(values.begin(), values.end(), [](int8_t v) { return v >= 0 && v <= 2; });
}

template <typename Reply, typename Answer>
Reply ReplyOf(const Answer& answer) {
  Reply reply{};
  reply.header.revision = static_cast<int64_t>(answer.revision);
  return reply;
}

}  // namespace

std::string ReplyChannel(const std::string& channel_prefix, uint64_t client) {
  return fmt::format("{}_REPLIES_{:016x}", channel_prefix, client);
}

absl::Status StatusOf(const reply_t& header) {
  return {static_cast<absl::StatusCode>(header.status), PlainText(header.status_text)};
}

void SetStatus(const absl::Status& status, reply_t& header) {
  header.status = static_cast<int32_t>(status.code());
  header.status_text = ErrorText(status).substr(0, kMaxStatusText);
}

std::vector<Chunk> Split(const PointsQuery& query) {
  return CutEvenly(query.points_m.size(), kMaxItemBytes / PointBytes(query.with_hessians));
}

std::vector<Chunk> Split(const RaysQuery& query) {
  return SplitByWork(query.rays, kMaxLengthOfRays_m, [](const Ray&) { return kRayBytes; });
}

std::vector<Chunk> Split(const SweepsQuery& query) {
  return SplitByWork(query.sweeps, kMaxSweptArea_m2,
                     [](const Sweep& sweep) { return SweepBytes(sweep.path_m.size()); });
}

std::vector<Chunk> Split(const RasterQuery& query) {
  return CutEvenly(size_t{1} * query.width * query.height, kMaxCellsOfChunk);
}

std::vector<Chunk> Split(const LikelihoodsQuery& query) {
  return CutEvenly(query.world_T_robot.size(), MaxPoses(query.hits_robot_m.size()));
}

std::vector<Chunk> Split(const DistancesQuery& query) {
  return CutEvenly(query.points_m.size(), MaxDistances(query.max_distance_m));
}

rays_request_t ToMessage(const RaysQuery& query, Chunk chunk) {
  rays_request_t request{};
  request.occupied_log_odds = query.occupied_log_odds;
  request.unknown = static_cast<int8_t>(query.unknown);
  request.num_rays = static_cast<int32_t>(chunk.size());
  for (size_t k = chunk.begin; k < chunk.end; ++k) {
    const Ray& ray = query.rays[k];
    request.x_m.push_back(ray.origin_m.x());
    request.y_m.push_back(ray.origin_m.y());
    request.bearing_rad.push_back(ray.bearing_rad);
    request.max_range_m.push_back(ray.max_range_m);
  }
  return request;
}

sweeps_request_t ToMessage(const SweepsQuery& query, Chunk chunk) {
  sweeps_request_t request{};
  request.occupied_log_odds = query.occupied_log_odds;
  request.unknown = static_cast<int8_t>(query.unknown);
  request.num_sweeps = static_cast<int32_t>(chunk.size());
  for (size_t k = chunk.begin; k < chunk.end; ++k) {
    const Sweep& sweep = query.sweeps[k];
    sweep_t& message = request.sweeps.emplace_back();
    message.radius_m = sweep.radius_m;
    message.num_vertices = static_cast<int32_t>(sweep.path_m.size());
    for (const Eigen::Vector2d& vertex_m : sweep.path_m) {
      message.x_m.push_back(vertex_m.x());
      message.y_m.push_back(vertex_m.y());
    }
  }
  return request;
}

raster_request_t ToMessage(const RasterQuery& query, Chunk chunk) {
  raster_request_t request{};
  request.first_x_m = query.first_m.x();
  request.first_y_m = query.first_m.y();
  request.resolution_m = query.resolution_m;
  request.width = query.width;
  request.height = query.height;
  request.first_cell = static_cast<int32_t>(chunk.begin);
  request.num_cells = static_cast<int32_t>(chunk.size());
  return request;
}

likelihoods_request_t ToMessage(const LikelihoodsQuery& query, Chunk chunk) {
  likelihoods_request_t request{};
  request.num_hits = static_cast<int32_t>(query.hits_robot_m.size());
  for (const Eigen::Vector2d& hit_m : query.hits_robot_m) {
    request.hit_x_m.push_back(hit_m.x());
    request.hit_y_m.push_back(hit_m.y());
  }
  request.num_poses = static_cast<int32_t>(chunk.size());
  for (size_t k = chunk.begin; k < chunk.end; ++k) {
    const Pose2& pose = query.world_T_robot[k];
    request.x_m.push_back(pose.position_m.x());
    request.y_m.push_back(pose.position_m.y());
    request.yaw_rad.push_back(pose.yaw_rad);
  }
  return request;
}

distances_request_t ToMessage(const DistancesQuery& query, Chunk chunk) {
  distances_request_t request{};
  request.max_distance_m = query.max_distance_m;
  request.occupied_log_odds = query.occupied_log_odds;
  request.num_points = static_cast<int32_t>(chunk.size());
  for (size_t k = chunk.begin; k < chunk.end; ++k) {
    request.x_m.push_back(query.points_m[k].x());
    request.y_m.push_back(query.points_m[k].y());
  }
  return request;
}

absl::Status CheckNumPoints(size_t num_points, bool with_hessians) {
  return CheckSize(num_points, kMaxItemBytes / PointBytes(with_hessians), "points");
}

absl::StatusOr<RaysQuery> FromMessage(const rays_request_t& request) {
  SPLINEMAP_RETURN_IF_ERROR(CheckSize(request.num_rays, kMaxItemBytes / kRayBytes, "rays"));
  RaysQuery query{.rays = {},
                  .occupied_log_odds = request.occupied_log_odds,
                  .unknown = static_cast<UnknownPolicy>(request.unknown)};
  for (size_t k = 0; k < request.x_m.size(); ++k) {
    query.rays.push_back(
        {{request.x_m[k], request.y_m[k]}, request.bearing_rad[k], request.max_range_m[k]});
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckWork(query.rays, kMaxLengthOfRays_m, "rays", "m"));
  return query;
}

absl::StatusOr<SweepsQuery> FromMessage(const sweeps_request_t& request) {
  SweepsQuery query{.sweeps = {},
                    .occupied_log_odds = request.occupied_log_odds,
                    .unknown = static_cast<UnknownPolicy>(request.unknown)};
  size_t bytes = 0;
  for (const sweep_t& message : request.sweeps) {
    bytes += SweepBytes(message.x_m.size());
    if (bytes > kMaxItemBytes) {
      return InvalidArgument(
          "{} sweeps in one request; 12 bytes each and 16 for each vertex, and no less than 26 "
          "for each sweep, may be {}, so that request and reply fit {} bytes",
          request.num_sweeps, kMaxItemBytes, kMaxRpcBytes);
    }
    query.sweeps.push_back({Points(message.x_m, message.y_m), message.radius_m});
  }
  SPLINEMAP_RETURN_IF_ERROR(
      CheckWork(query.sweeps, kMaxSweptArea_m2, "sweeps, a metre around them included,", "m2"));
  return query;
}

absl::StatusOr<LikelihoodsQuery> FromMessage(const likelihoods_request_t& request) {
  SPLINEMAP_RETURN_IF_ERROR(CheckSize(request.num_hits, LikelihoodsQuery::kMaxHits, "hits"));
  if (static_cast<size_t>(request.num_poses) > MaxPoses(request.hit_x_m.size())) {
    return InvalidArgument(
        "{} poses for {} hits in one request; {} are allowed, so that it fits {} bytes, and poses "
        "times hits are {} at most",
        request.num_poses, request.num_hits, MaxPoses(request.hit_x_m.size()), kMaxRpcBytes,
        kMaxHitsAtPoses);
  }
  LikelihoodsQuery query{.hits_robot_m = Points(request.hit_x_m, request.hit_y_m),
                         .world_T_robot = {}};
  for (size_t k = 0; k < request.x_m.size(); ++k) {
    query.world_T_robot.push_back({{request.x_m[k], request.y_m[k]}, request.yaw_rad[k]});
  }
  return query;
}

absl::StatusOr<DistancesQuery> FromMessage(const distances_request_t& request) {
  const size_t max_points = MaxDistances(request.max_distance_m);
  if (static_cast<size_t>(request.num_points) > max_points) {
    return InvalidArgument("{} points within {} m in one request; {} are allowed",
                           request.num_points, request.max_distance_m, max_points);
  }
  return DistancesQuery{.points_m = Points(request.x_m, request.y_m),
                        .max_distance_m = request.max_distance_m,
                        .occupied_log_odds = request.occupied_log_odds};
}

absl::StatusOr<RasterPart> FromMessage(const raster_request_t& request) {
  const RasterQuery raster{.first_m = {request.first_x_m, request.first_y_m},
                           .resolution_m = request.resolution_m,
                           .width = request.width,
                           .height = request.height};
  SPLINEMAP_RETURN_IF_ERROR(Check(raster));
  const int64_t end = int64_t{request.first_cell} + request.num_cells;
  if (request.first_cell < 0 || request.num_cells < 0 ||
      end > int64_t{raster.width} * raster.height) {
    return InvalidArgument("cells {} to {} of a raster of {} x {}", request.first_cell, end - 1,
                           raster.width, raster.height);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckSize(request.num_cells, kMaxCellsOfChunk, "cells"));
  return RasterPart{raster, {static_cast<size_t>(request.first_cell), static_cast<size_t>(end)}};
}

rays_reply_t ToMessage(const RaysQuery::Answer& answer) {
  auto reply = ReplyOf<rays_reply_t>(answer);
  reply.num_rays = static_cast<int32_t>(answer.ends.size());
  for (const RaysQuery::End& end : answer.ends) {
    reply.occupancy.push_back(static_cast<int8_t>(end.occupancy));
    reply.range_m.push_back(end.range_m);
  }
  return reply;
}

sweeps_reply_t ToMessage(const SweepsQuery::Answer& answer) {
  auto reply = ReplyOf<sweeps_reply_t>(answer);
  reply.num_sweeps = static_cast<int32_t>(answer.results.size());
  for (const SweepsQuery::Result& result : answer.results) {
    reply.occupancy.push_back(static_cast<int8_t>(result.occupancy));
    reply.is_certified.push_back(result.is_certified ? 1 : 0);
    reply.free_m.push_back(result.free_m);
    reply.contact_x_m.push_back(result.contact_m.x());
    reply.contact_y_m.push_back(result.contact_m.y());
  }
  return reply;
}

raster_reply_t ToMessage(const RasterQuery::Answer& answer) {
  auto reply = ReplyOf<raster_reply_t>(answer);
  reply.num_cells = static_cast<int32_t>(answer.cells.size());
  reply.cells = answer.cells;
  return reply;
}

likelihoods_reply_t ToMessage(const LikelihoodsQuery::Answer& answer) {
  auto reply = ReplyOf<likelihoods_reply_t>(answer);
  reply.num_poses = static_cast<int32_t>(answer.log_likelihoods.size());
  reply.log_likelihoods = answer.log_likelihoods;
  return reply;
}

distances_reply_t ToMessage(const DistancesQuery::Answer& answer) {
  auto reply = ReplyOf<distances_reply_t>(answer);
  reply.num_points = static_cast<int32_t>(answer.distances.size());
  for (const DistancesQuery::Distance& distance : answer.distances) {
    reply.distance_m.push_back(distance.distance_m);
    reply.gradient_x.push_back(distance.gradient.x());
    reply.gradient_y.push_back(distance.gradient.y());
  }
  return reply;
}

absl::Status HandleReply(const rays_reply_t& reply, const RaysQuery& query, Chunk chunk,
                         RaysQuery::Answer& answer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckReply(reply.num_rays, chunk));
  if (!AreOccupancies(reply.occupancy)) return InvalidArgument("a reply of no known occupancy");
  answer.revision = static_cast<uint64_t>(reply.header.revision);
  answer.ends.resize(query.rays.size());
  for (size_t k = 0; k < chunk.size(); ++k) {
    answer.ends[chunk.begin + k] = {static_cast<Occupancy>(reply.occupancy[k]), reply.range_m[k]};
  }
  return absl::OkStatus();
}

absl::Status HandleReply(const sweeps_reply_t& reply, const SweepsQuery& query, Chunk chunk,
                         SweepsQuery::Answer& answer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckReply(reply.num_sweeps, chunk));
  if (!AreOccupancies(reply.occupancy)) return InvalidArgument("a reply of no known occupancy");
  answer.revision = static_cast<uint64_t>(reply.header.revision);
  answer.results.resize(query.sweeps.size());
  for (size_t k = 0; k < chunk.size(); ++k) {
    answer.results[chunk.begin + k] = {static_cast<Occupancy>(reply.occupancy[k]),
                                       reply.is_certified[k] != 0,
                                       reply.free_m[k],
                                       {reply.contact_x_m[k], reply.contact_y_m[k]}};
  }
  return absl::OkStatus();
}

absl::Status HandleReply(const raster_reply_t& reply, const RasterQuery& query, Chunk chunk,
                         RasterQuery::Answer& answer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckReply(reply.num_cells, chunk));
  answer.revision = static_cast<uint64_t>(reply.header.revision);
  answer.cells.resize(size_t{1} * query.width * query.height);
  std::copy(reply.cells.begin(), reply.cells.end(), answer.cells.begin() + chunk.begin);
  return absl::OkStatus();
}

absl::Status HandleReply(const likelihoods_reply_t& reply, const LikelihoodsQuery& query,
                         Chunk chunk, LikelihoodsQuery::Answer& answer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckReply(reply.num_poses, chunk));
  answer.revision = static_cast<uint64_t>(reply.header.revision);
  answer.log_likelihoods.resize(query.world_T_robot.size());
  std::copy(reply.log_likelihoods.begin(), reply.log_likelihoods.end(),
            answer.log_likelihoods.begin() + chunk.begin);
  return absl::OkStatus();
}

absl::Status HandleReply(const distances_reply_t& reply, const DistancesQuery& query, Chunk chunk,
                         DistancesQuery::Answer& answer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckReply(reply.num_points, chunk));
  answer.revision = static_cast<uint64_t>(reply.header.revision);
  answer.distances.resize(query.points_m.size());
  for (size_t k = 0; k < chunk.size(); ++k) {
    answer.distances[chunk.begin + k] = {reply.distance_m[k],
                                         {reply.gradient_x[k], reply.gradient_y[k]}};
  }
  return absl::OkStatus();
}

}  // namespace splinemap
