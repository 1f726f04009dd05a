#include "lib/rpc/answer.h"

#include <algorithm>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/base/status.h"
#include "lib/rpc/encoded.h"
#include "lib/wire/decode.h"
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

template <typename Message>
bool IsOf(absl::Span<const uint8_t> bytes) {
  return FingerprintOf(bytes) == static_cast<uint64_t>(Message::getHash());
}

template <typename Reply>
std::vector<uint8_t> Refuse(const absl::Status& why, const reply_t& header) {
  Reply reply{};
  reply.header = header;
  SetStatus(why, reply.header);
  return Encode(reply);
}

template <typename Query>
std::vector<uint8_t> Answer(absl::Span<const uint8_t> bytes, const QueryableMap& map,
                            const reply_t& header) {
  const auto query = DecodeRequest<Query>(bytes);
  if (!query) return {};
  const auto answer = AnswerOf(*query, map);
  if (!answer.ok()) return Refuse<typename Rpc<Query>::Reply>(answer.status(), header);
  reply_t complete = header;
  complete.revision = static_cast<int64_t>(answer->revision);  // of the state that answered
  return EncodeReply(*answer, complete);
}

}  // namespace

std::vector<uint8_t> AnswerRequest(absl::Span<const uint8_t> request, const QueryableMap& map,
                                   const reply_t& header) {
  std::vector<uint8_t> reply;
  AllQueries::ForEach([&]<typename Query>() {
    if (IsOf<typename Rpc<Query>::Request>(request)) reply = Answer<Query>(request, map, header);
  });
  return reply;
}

std::vector<uint8_t> RefuseRequest(absl::Span<const uint8_t> request, const absl::Status& why,
                                   const reply_t& header) {
  std::vector<uint8_t> reply;
  AllQueries::ForEach([&]<typename Query>() {
    if (IsOf<typename Rpc<Query>::Request>(request)) {
      reply = Refuse<typename Rpc<Query>::Reply>(why, header);
    }
  });
  if (IsOf<command_request_t>(request) || IsOf<layer_command_request_t>(request)) {
    reply = Refuse<command_reply_t>(why, header);
  }
  return reply;
}

std::vector<std::string> QueryChannels(const std::string& channel_prefix) {
  std::vector<std::string> channels;
  AllQueries::ForEach(
      [&]<typename Query>() { channels.push_back(channel_prefix + Rpc<Query>::kChannel); });
  return channels;
}

}  // namespace splinemap
