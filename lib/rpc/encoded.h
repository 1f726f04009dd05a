#pragma once

#include <cstdint>
#include <optional>
#include <type_traits>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/base/status.h"
#include "lib/rpc/messages.h"
#include "lib/rpc/points_in_place.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

// Queries and answers as the bytes of messages.

namespace splinemap {

// A client asks for a chunk.
template <typename Query>
std::vector<uint8_t> EncodeRequest(const Query& query, Chunk chunk, const request_t& header) {
  auto request = ToMessage(query, chunk);
  request.header = header;
  return Encode(request);
}

// What a request asks for, or why it is refused, as FromMessage() says; nothing where it is
// damaged.
template <typename Query>
auto DecodeRequest(absl::Span<const uint8_t> message) {
  if constexpr (std::is_same_v<Query, PointsQuery>) {
    return DecodePointsRequest(message);
  } else {
    const auto request = Decode<typename Rpc<Query>::Request>(message);
    return request.ok() ? std::optional(FromMessage(*request)) : std::nullopt;
  }
}

// `header` is complete.
template <typename Answer>
std::vector<uint8_t> EncodeReply(const Answer& answer, const reply_t& header) {
  auto reply = ToMessage(answer);
  reply.header = header;
  return Encode(reply);
}

// Puts what a reply of status 0 says where it belongs; its header. InvalidArgument, and the answer
// is unchanged, where it is damaged or does not answer that chunk.
template <typename Query>
absl::StatusOr<reply_t> HandleReply(absl::Span<const uint8_t> message, const Query& query,
                                    Chunk chunk, typename Query::Answer& answer) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto reply, Decode<typename Rpc<Query>::Reply>(message));
  if (reply.header.status == 0) {
    SPLINEMAP_RETURN_IF_ERROR(HandleReply(reply, query, chunk, answer));
  }
  return reply.header;
}

}  // namespace splinemap
