#include "lib/rpc/answer.h"

#include <algorithm>

#include "lib/base/status.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

template <typename Query>
absl::StatusOr<typename Query::Answer> AnswerOf(const absl::StatusOr<Query>& query,
                                                const QueryableMap& map) {
  SPLINEMAP_RETURN_IF_ERROR(query.status());
  return map.Ask(*query);
}

absl::StatusOr<RasterQuery::Answer> AnswerOf(const absl::StatusOr<RasterPart>& part,
                                             const QueryableMap& map) {
  SPLINEMAP_RETURN_IF_ERROR(part.status());
  PointsQuery query;
  query.points_m.reserve(part->cells.size());
  for (size_t cell = part->cells.begin; cell < part->cells.end; ++cell) {
    query.points_m.push_back(PointOfCell(part->raster, cell));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const PointsQuery::Answer points, map.Ask(query));
  RasterQuery::Answer answer{.revision = points.revision, .cells = {}};
  answer.cells.reserve(points.samples.size());
  std::transform(points.samples.begin(), points.samples.end(), std::back_inserter(answer.cells),
                 CellOf);
  return answer;
}

template <typename Reply>
std::vector<uint8_t> Refuse(const absl::Status& why, const reply_t& head) {
  Reply reply{};
  reply.head = head;
  SetStatus(why, reply.head);
  return Encode(reply);
}

template <typename Query>
std::vector<uint8_t> Answer(absl::Span<const uint8_t> bytes, const QueryableMap& map,
                            const reply_t& head) {
  const auto request = DecodeRpc<typename Rpc<Query>::Request>(bytes);
  if (!request.ok()) return {};
  const auto answer = AnswerOf(FromMessage(*request), map);
  if (!answer.ok()) return Refuse<typename Rpc<Query>::Reply>(answer.status(), head);
  auto reply = ToMessage(*answer);
  const int64_t revision = reply.head.revision;
  reply.head = head;
  reply.head.revision = revision;
  return Encode(reply);
}

}  // namespace

std::vector<uint8_t> AnswerRequest(absl::Span<const uint8_t> request, const QueryableMap& map,
                                   const reply_t& head) {
  switch (TypeOf(request).value_or(MessageType::kStatus)) {
    case MessageType::kPointsRequest:
      return Answer<PointsQuery>(request, map, head);
    case MessageType::kRaysRequest:
      return Answer<RaysQuery>(request, map, head);
    case MessageType::kSweepsRequest:
      return Answer<SweepsQuery>(request, map, head);
    case MessageType::kRasterRequest:
      return Answer<RasterQuery>(request, map, head);
    case MessageType::kLikelihoodsRequest:
      return Answer<LikelihoodsQuery>(request, map, head);
    case MessageType::kDistancesRequest:
      return Answer<DistancesQuery>(request, map, head);
    default:
      return {};
  }
}

std::vector<uint8_t> RefuseRequest(absl::Span<const uint8_t> request, const absl::Status& why,
                                   const reply_t& head) {
  switch (TypeOf(request).value_or(MessageType::kStatus)) {
    case MessageType::kPointsRequest:
      return Refuse<points_reply_t>(why, head);
    case MessageType::kRaysRequest:
      return Refuse<rays_reply_t>(why, head);
    case MessageType::kSweepsRequest:
      return Refuse<sweeps_reply_t>(why, head);
    case MessageType::kRasterRequest:
      return Refuse<raster_reply_t>(why, head);
    case MessageType::kLikelihoodsRequest:
      return Refuse<likelihoods_reply_t>(why, head);
    case MessageType::kDistancesRequest:
      return Refuse<distances_reply_t>(why, head);
    case MessageType::kCommandRequest:
    case MessageType::kLayerCommandRequest:
      return Refuse<command_reply_t>(why, head);
    default:
      return {};
  }
}

}  // namespace splinemap
