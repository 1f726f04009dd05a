#include "lib/fleet/query_records.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>
#include <utility>

#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/fleet/queries.pb.h"

namespace splinemap {
namespace {

constexpr size_t kMaxReplyText = 600;

template <typename Numbers>
bool AreFinite(const Numbers& numbers) {
  return std::all_of(numbers.begin(), numbers.end(), [](double x) { return std::isfinite(x); });
}

// Whether all lists have `size` numbers, and finite ones.
template <typename... Numbers>
bool Have(size_t size, const Numbers&... numbers) {
  return ((static_cast<size_t>(numbers.size()) == size && AreFinite(numbers)) && ...);
}

absl::Status UnevenLists() {
  return InvalidArgument("a request whose lists are of unequal length");
}

template <typename Message>
void WritePoints(const std::vector<Eigen::Vector2d>& points_m, Message& message) {
  for (const Eigen::Vector2d& point_m : points_m) {
    message.add_x_m(point_m.x());
    message.add_y_m(point_m.y());
  }
}

template <typename Message>
std::vector<Eigen::Vector2d> ReadPoints(const Message& message) {
  std::vector<Eigen::Vector2d> points_m(static_cast<size_t>(message.x_m_size()));
  for (int k = 0; k < message.x_m_size(); ++k) points_m[k] = {message.x_m(k), message.y_m(k)};
  return points_m;
}

UnknownPolicy PolicyOf(uint32_t unknown) {
  return static_cast<UnknownPolicy>(std::min<uint32_t>(unknown, 127));  // Check() looks at it
}

// Requests.

void Write(const PointsQuery& query, fleet::Request& request) {
  fleet::PointsRequest& points = *request.mutable_points();
  WritePoints(query.points_m, points);
  points.set_with_hessians(query.with_hessians);
}

absl::StatusOr<FleetQuery> Read(const fleet::PointsRequest& request) {
  if (request.x_m_size() != request.y_m_size()) return UnevenLists();
  return PointsQuery{ReadPoints(request), request.with_hessians()};
}

void Write(const RaysQuery& query, fleet::Request& request) {
  fleet::RaysRequest& rays = *request.mutable_rays();
  for (const Ray& ray : query.rays) {
    rays.add_origin_x_m(ray.origin_m.x());
    rays.add_origin_y_m(ray.origin_m.y());
    rays.add_bearing_rad(ray.bearing_rad);
    rays.add_max_range_m(ray.max_range_m);
  }
  rays.set_occupied_log_odds(query.occupied_log_odds);
  rays.set_unknown(static_cast<uint32_t>(query.unknown));
}

absl::StatusOr<FleetQuery> Read(const fleet::RaysRequest& request) {
  const int size = request.origin_x_m_size();
  if (request.origin_y_m_size() != size || request.bearing_rad_size() != size ||
      request.max_range_m_size() != size) {
    return UnevenLists();
  }
  RaysQuery query;
  query.rays.reserve(static_cast<size_t>(size));
  for (int k = 0; k < size; ++k) {
    query.rays.push_back({{request.origin_x_m(k), request.origin_y_m(k)},
                          request.bearing_rad(k),
                          request.max_range_m(k)});
  }
  query.occupied_log_odds = request.occupied_log_odds();
  query.unknown = PolicyOf(request.unknown());
  return query;
}

void Write(const SweepsQuery& query, fleet::Request& request) {
  fleet::SweepsRequest& sweeps = *request.mutable_sweeps();
  for (const Sweep& sweep : query.sweeps) {
    sweeps.add_num_vertices(static_cast<uint32_t>(sweep.path_m.size()));
    sweeps.add_radius_m(sweep.radius_m);
    WritePoints(sweep.path_m, sweeps);
  }
  sweeps.set_occupied_log_odds(query.occupied_log_odds);
  sweeps.set_unknown(static_cast<uint32_t>(query.unknown));
}

absl::StatusOr<FleetQuery> Read(const fleet::SweepsRequest& request) {
  if (request.num_vertices_size() != request.radius_m_size() ||
      request.x_m_size() != request.y_m_size()) {
    return UnevenLists();
  }
  const std::vector<Eigen::Vector2d> vertices_m = ReadPoints(request);
  SweepsQuery query;
  query.sweeps.reserve(static_cast<size_t>(request.radius_m_size()));
  size_t begin = 0;
  for (int k = 0; k < request.radius_m_size(); ++k) {
    const size_t size = request.num_vertices(k);
    if (size > vertices_m.size() - begin) return UnevenLists();
    const auto first = vertices_m.begin() + static_cast<ptrdiff_t>(begin);
    query.sweeps.push_back({{first, first + static_cast<ptrdiff_t>(size)}, request.radius_m(k)});
    begin += size;
  }
  if (begin != vertices_m.size()) return UnevenLists();
  query.occupied_log_odds = request.occupied_log_odds();
  query.unknown = PolicyOf(request.unknown());
  return query;
}

void Write(const RasterCells& query, fleet::Request& request) {
  fleet::RasterRequest& raster = *request.mutable_raster();
  raster.set_first_x_m(query.raster.first_m.x());
  raster.set_first_y_m(query.raster.first_m.y());
  raster.set_resolution_m(query.raster.resolution_m);
  raster.set_width(query.raster.width);
  raster.set_height(query.raster.height);
  for (const RasterCells::Rectangle& rectangle : query.rectangles) {
    raster.add_column0(rectangle.column0);
    raster.add_row0(rectangle.row0);
    raster.add_column1(rectangle.column1);
    raster.add_row1(rectangle.row1);
  }
}

absl::StatusOr<FleetQuery> Read(const fleet::RasterRequest& request) {
  const int size = request.column0_size();
  if (request.row0_size() != size || request.column1_size() != size ||
      request.row1_size() != size) {
    return UnevenLists();
  }
  RasterCells query;
  query.raster = {.first_m = {request.first_x_m(), request.first_y_m()},
                  .resolution_m = request.resolution_m(),
                  .width = request.width(),
                  .height = request.height()};
  for (int k = 0; k < size; ++k) {
    query.rectangles.push_back(
        {request.column0(k), request.row0(k), request.column1(k), request.row1(k)});
  }
  return query;
}

void Write(const LikelihoodsQuery& query, fleet::Request& request) {
  fleet::LikelihoodsRequest& likelihoods = *request.mutable_likelihoods();
  for (const Eigen::Vector2d& hit_m : query.hits_robot_m) {
    likelihoods.add_hit_x_m(hit_m.x());
    likelihoods.add_hit_y_m(hit_m.y());
  }
  for (const Pose2& pose : query.world_T_robot) {
    likelihoods.add_pose_x_m(pose.position_m.x());
    likelihoods.add_pose_y_m(pose.position_m.y());
    likelihoods.add_pose_yaw_rad(pose.yaw_rad);
  }
}

absl::StatusOr<FleetQuery> Read(const fleet::LikelihoodsRequest& request) {
  const int poses = request.pose_x_m_size();
  if (request.hit_x_m_size() != request.hit_y_m_size() || request.pose_y_m_size() != poses ||
      request.pose_yaw_rad_size() != poses) {
    return UnevenLists();
  }
  LikelihoodsQuery query;
  for (int k = 0; k < request.hit_x_m_size(); ++k) {
    query.hits_robot_m.emplace_back(request.hit_x_m(k), request.hit_y_m(k));
  }
  for (int k = 0; k < poses; ++k) {
    query.world_T_robot.push_back(
        {{request.pose_x_m(k), request.pose_y_m(k)}, request.pose_yaw_rad(k)});
  }
  return query;
}

void Write(const DistancesQuery& query, fleet::Request& request) {
  fleet::DistancesRequest& distances = *request.mutable_distances();
  WritePoints(query.points_m, distances);
  distances.set_max_distance_m(query.max_distance_m);
  distances.set_occupied_log_odds(query.occupied_log_odds);
}

absl::StatusOr<FleetQuery> Read(const fleet::DistancesRequest& request) {
  if (request.x_m_size() != request.y_m_size()) return UnevenLists();
  return DistancesQuery{ReadPoints(request), request.max_distance_m(), request.occupied_log_odds()};
}

void Write(const BlocksQuery& query, fleet::Request& request) {
  fleet::BlocksRequest& blocks = *request.mutable_blocks();
  for (const BlockKey& block : query.blocks) {
    blocks.add_x(block.x);
    blocks.add_y(block.y);
  }
}

absl::StatusOr<FleetQuery> Read(const fleet::BlocksRequest& request) {
  if (request.x_size() != request.y_size()) return UnevenLists();
  BlocksQuery query;
  for (int k = 0; k < request.x_size(); ++k) query.blocks.push_back({request.x(k), request.y(k)});
  return query;
}

absl::StatusOr<FleetQuery> ReadQuery(const fleet::Request& request) {
  switch (request.ask_case()) {
    case fleet::Request::kPoints:
      return Read(request.points());
    case fleet::Request::kRays:
      return Read(request.rays());
    case fleet::Request::kSweeps:
      return Read(request.sweeps());
    case fleet::Request::kRaster:
      return Read(request.raster());
    case fleet::Request::kLikelihoods:
      return Read(request.likelihoods());
    case fleet::Request::kDistances:
      return Read(request.distances());
    case fleet::Request::kBlocks:
      return Read(request.blocks());
    case fleet::Request::ASK_NOT_SET:
      break;
  }
  return InvalidArgument("a request of a kind that this worker does not know");
}

// Replies.

bool AreOccupancyNumbers(const google::protobuf::RepeatedField<uint32_t>& numbers) {
  return std::all_of(numbers.begin(), numbers.end(), [](uint32_t number) { return number <= 2; });
}

void Write(const PointsQuery::Answer& answer, fleet::Reply& reply) {
  fleet::PointsReply& points = *reply.mutable_points();
  for (const SurfaceSample& sample : answer.samples) {
    points.add_log_odds(sample.log_odds);
    points.add_gradient_x_per_m(sample.gradient_per_m.x());
    points.add_gradient_y_per_m(sample.gradient_per_m.y());
    points.add_known(sample.known);
  }
  for (const Eigen::Matrix2d& hessian : answer.hessians_per_m2) {
    points.add_hessian_xx_per_m2(hessian(0, 0));
    points.add_hessian_xy_per_m2(hessian(0, 1));
    points.add_hessian_yy_per_m2(hessian(1, 1));
  }
}

bool Read(const fleet::Reply& reply, const PointsQuery& query, PointsQuery::Answer& answer) {
  const fleet::PointsReply& points = reply.points();
  const size_t size = query.points_m.size();
  const size_t hessians = query.with_hessians ? size : 0;
  if (!Have(size, points.log_odds(), points.gradient_x_per_m(), points.gradient_y_per_m(),
            points.known()) ||
      !Have(hessians, points.hessian_xx_per_m2(), points.hessian_xy_per_m2(),
            points.hessian_yy_per_m2())) {
    return false;
  }
  for (int k = 0; k < static_cast<int>(size); ++k) {
    answer.samples.push_back({{points.gradient_x_per_m(k), points.gradient_y_per_m(k)},
                              points.log_odds(k),
                              points.known(k)});
  }
  for (int k = 0; k < static_cast<int>(hessians); ++k) {
    answer.hessians_per_m2.emplace_back() << points.hessian_xx_per_m2(k),
        points.hessian_xy_per_m2(k), points.hessian_xy_per_m2(k), points.hessian_yy_per_m2(k);
  }
  return true;
}

void Write(const RaysQuery::Answer& answer, fleet::Reply& reply) {
  fleet::RaysReply& rays = *reply.mutable_rays();
  for (const RaysQuery::End& end : answer.ends) {
    rays.add_occupancy(static_cast<uint32_t>(end.occupancy));
    rays.add_range_m(end.range_m);
  }
}

bool Read(const fleet::Reply& reply, const RaysQuery& query, RaysQuery::Answer& answer) {
  const fleet::RaysReply& rays = reply.rays();
  const size_t size = query.rays.size();
  if (!Have(size, rays.occupancy(), rays.range_m()) || !AreOccupancyNumbers(rays.occupancy())) {
    return false;
  }
  for (int k = 0; k < static_cast<int>(size); ++k) {
    answer.ends.push_back({static_cast<Occupancy>(rays.occupancy(k)), rays.range_m(k)});
  }
  return true;
}

void Write(const SweepsQuery::Answer& answer, fleet::Reply& reply) {
  fleet::SweepsReply& sweeps = *reply.mutable_sweeps();
  for (const SweepsQuery::Result& result : answer.results) {
    sweeps.add_occupancy(static_cast<uint32_t>(result.occupancy));
    sweeps.add_is_certified(result.is_certified);
    sweeps.add_free_m(result.free_m);
    sweeps.add_contact_x_m(result.contact_m.x());
    sweeps.add_contact_y_m(result.contact_m.y());
  }
}

bool Read(const fleet::Reply& reply, const SweepsQuery& query, SweepsQuery::Answer& answer) {
  const fleet::SweepsReply& sweeps = reply.sweeps();
  const size_t size = query.sweeps.size();
  if (!Have(size, sweeps.occupancy(), sweeps.is_certified(), sweeps.free_m(), sweeps.contact_x_m(),
            sweeps.contact_y_m()) ||
      !AreOccupancyNumbers(sweeps.occupancy())) {
    return false;
  }
  for (int k = 0; k < static_cast<int>(size); ++k) {
    answer.results.push_back({static_cast<Occupancy>(sweeps.occupancy(k)),
                              sweeps.is_certified(k),
                              sweeps.free_m(k),
                              {sweeps.contact_x_m(k), sweeps.contact_y_m(k)}});
  }
  return true;
}

size_t CellsOf(const RasterCells& query) {
  size_t cells = 0;
  for (const RasterCells::Rectangle& rectangle : query.rectangles) cells += rectangle.size();
  return cells;
}

void Write(const RasterQuery::Answer& answer, fleet::Reply& reply) {
  fleet::RasterReply& raster = *reply.mutable_raster();
  for (const int16_t cell : answer.cells) raster.add_cell(cell);
}

bool Read(const fleet::Reply& reply, const RasterCells& query, RasterQuery::Answer& answer) {
  const auto& cells = reply.raster().cell();
  if (static_cast<size_t>(cells.size()) != CellsOf(query)) return false;
  for (const int32_t cell : cells) {
    if (std::abs(int64_t{cell}) > std::numeric_limits<int16_t>::max()) return false;
    answer.cells.push_back(static_cast<int16_t>(cell));
  }
  return true;
}

void Write(const LikelihoodsQuery::Answer& answer, fleet::Reply& reply) {
  fleet::LikelihoodsReply& likelihoods = *reply.mutable_likelihoods();
  for (const double log_likelihood : answer.log_likelihoods) {
    likelihoods.add_log_likelihood(log_likelihood);
  }
}

bool Read(const fleet::Reply& reply, const LikelihoodsQuery& query,
          LikelihoodsQuery::Answer& answer) {
  const auto& found = reply.likelihoods().log_likelihood();
  if (!Have(query.world_T_robot.size(), found)) return false;
  answer.log_likelihoods.assign(found.begin(), found.end());
  return true;
}

void Write(const DistancesQuery::Answer& answer, fleet::Reply& reply) {
  fleet::DistancesReply& distances = *reply.mutable_distances();
  for (const DistancesQuery::Distance& distance : answer.distances) {
    distances.add_distance_m(distance.distance_m);
    distances.add_gradient_x(distance.gradient.x());
    distances.add_gradient_y(distance.gradient.y());
  }
}

bool Read(const fleet::Reply& reply, const DistancesQuery& query, DistancesQuery::Answer& answer) {
  const fleet::DistancesReply& distances = reply.distances();
  const size_t size = query.points_m.size();
  if (!Have(size, distances.distance_m(), distances.gradient_x(), distances.gradient_y())) {
    return false;
  }
  for (int k = 0; k < static_cast<int>(size); ++k) {
    answer.distances.push_back(
        {distances.distance_m(k), {distances.gradient_x(k), distances.gradient_y(k)}});
  }
  return true;
}

void Write(const BlocksQuery::Answer& answer, fleet::Reply& reply) {
  fleet::BlocksReply& blocks = *reply.mutable_blocks();
  for (const std::string& block : answer.blocks) blocks.add_block(block);
}

bool Read(const fleet::Reply& reply, const BlocksQuery& query, BlocksQuery::Answer& answer) {
  const auto& blocks = reply.blocks().block();
  if (static_cast<size_t>(blocks.size()) != query.blocks.size()) return false;
  answer.blocks.assign(blocks.begin(), blocks.end());
  return true;
}

}  // namespace

absl::Status Check(const RasterCells& query) {
  const RasterQuery& raster = query.raster;
  SPLINEMAP_RETURN_IF_ERROR(Check(raster));
  for (const RasterCells::Rectangle& rectangle : query.rectangles) {
    if (rectangle.column0 < 0 || rectangle.column0 >= rectangle.column1 ||
        rectangle.column1 > raster.width || rectangle.row0 < 0 ||
        rectangle.row0 >= rectangle.row1 || rectangle.row1 > raster.height) {
      return InvalidArgument("columns {} to {} and rows {} to {} of a raster of {} x {}",
                             rectangle.column0, rectangle.column1, rectangle.row0, rectangle.row1,
                             raster.width, raster.height);
    }
  }
  return absl::OkStatus();
}

absl::Status Check(const BlocksQuery& query) {
  for (const BlockKey& block : query.blocks) {
    constexpr int32_t kMaxBlock = kMaxKnotIndex / (Tile::kSide * BlockKey::kSide);
    if (std::abs(int64_t{block.x}) > kMaxBlock || std::abs(int64_t{block.y}) > kMaxBlock) {
      return InvalidArgument("block {},{} is beyond every map", block.x, block.y);
    }
  }
  return absl::OkStatus();
}

std::vector<Chunk> Split(const RasterCells& query) {
  std::vector<Chunk> chunks{{0, 0}};
  size_t cells = 0;
  for (const RasterCells::Rectangle& rectangle : query.rectangles) {
    cells += rectangle.size();
    if (chunks.back().size() > 0 && cells > RasterCells::kMaxCells) {
      chunks.push_back({chunks.back().end, chunks.back().end});
      cells = rectangle.size();
    }
    ++chunks.back().end;
  }
  return chunks;
}

std::vector<Chunk> Split(const BlocksQuery& query) {
  std::vector<Chunk> chunks;
  size_t begin = 0;
  do {
    chunks.push_back({begin, std::min(begin + BlocksQuery::kMaxBlocks, query.blocks.size())});
    begin = chunks.back().end;
  } while (begin < query.blocks.size());
  return chunks;
}

namespace {

template <typename Query>
absl::Status CheckChunk(const Query& query) {
  SPLINEMAP_RETURN_IF_ERROR(Check(query));
  if (Split(query).size() == 1) return absl::OkStatus();
  return InvalidArgument("it asks for more than one request may; split it");
}

}  // namespace

std::string EncodeRequest(const FleetQueries::Any& query, double knot_interval_m) {
  fleet::Request request;
  request.set_knot_interval_m(knot_interval_m);
  std::visit([&](const auto* q) { Write(*q, request); }, query);
  return request.SerializeAsString();
}

absl::StatusOr<FleetRequest> DecodeRequest(const std::string& bytes) {
  fleet::Request request;
  if (!request.ParseFromString(bytes)) return InvalidArgument("it is no request");
  FleetRequest decoded{.knot_interval_m = request.knot_interval_m(), .query = {}};
  SPLINEMAP_ASSIGN_OR_RETURN(decoded.query, ReadQuery(request));
  SPLINEMAP_RETURN_IF_ERROR(
      std::visit([](const auto& query) { return CheckChunk(query); }, decoded.query));
  const auto* const raster = std::get_if<RasterCells>(&decoded.query);
  if (raster != nullptr && CellsOf(*raster) > RasterCells::kMaxCells) {
    return InvalidArgument("{} cells in one request; {} are allowed", CellsOf(*raster),
                           RasterCells::kMaxCells);
  }
  return decoded;
}

std::string EncodeReply(const absl::StatusOr<FleetQueries::AnyAnswer>& answer) {
  fleet::Reply reply;
  reply.set_code(static_cast<uint32_t>(answer.status().code()));
  if (answer.ok()) {
    std::visit(
        [&](const auto& a) {
          reply.set_revision(a.revision);
          Write(a, reply);
        },
        *answer);
  } else {
    reply.set_text(PlainText(ErrorText(answer.status())).substr(0, kMaxReplyText));
  }
  return reply.SerializeAsString();
}

absl::StatusOr<FleetQueries::AnyAnswer> DecodeReply(const std::string& bytes,
                                                    const FleetQueries::Any& query) {
  fleet::Reply reply;
  if (!reply.ParseFromString(bytes)) return DataLoss("what came from a worker is no reply");
  if (reply.code() != 0) {
    const bool is_known = reply.code() <= static_cast<uint32_t>(absl::StatusCode::kUnauthenticated);
    return absl::Status(
        is_known ? static_cast<absl::StatusCode>(reply.code()) : absl::StatusCode::kUnknown,
        PlainText(reply.text()));
  }
  return std::visit(
      [&](const auto* q) -> absl::StatusOr<FleetQueries::AnyAnswer> {
        typename std::remove_cvref_t<decltype(*q)>::Answer answer;
        answer.revision = reply.revision();
        if (!Read(reply, *q, answer)) return DataLoss("a worker replied to another query");
        return answer;
      },
      query);
}

}  // namespace splinemap
