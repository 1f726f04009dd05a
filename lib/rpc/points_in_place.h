#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/rpc/messages.h"

// Points are asked by the ten thousand: what is long of their messages is read and written where it
// stands, without a points_request_t or points_reply_t between. lib/rpc/encoded.h has this for all
// queries.

namespace splinemap {

std::vector<uint8_t> EncodeRequest(const PointsQuery& query, Chunk chunk, const request_t& header);

std::optional<absl::StatusOr<PointsQuery>> DecodePointsRequest(absl::Span<const uint8_t> message);

std::vector<uint8_t> EncodeReply(const PointsQuery::Answer& answer, const reply_t& header);

absl::StatusOr<reply_t> HandleReply(absl::Span<const uint8_t> message, const PointsQuery& query,
                                    Chunk chunk, PointsQuery::Answer& answer);

}  // namespace splinemap
