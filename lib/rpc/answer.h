#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "lib/query/queryable_map.h"
#include "lib/rpc/messages.h"

namespace splinemap {

// The encoded reply to a message that RequestHeadOf() takes for a request of a query, with what
// `map` says to it: an answer, or why there is none. Whatever the bytes are, of bounded size and
// work. `head` is complete but for revision and status. Empty for a message that is damaged.
std::vector<uint8_t> AnswerRequest(absl::Span<const uint8_t> request, const QueryableMap& map,
                                   const reply_t& head);

// The reply, without anything but its head, to any request, whose type alone is looked at.
std::vector<uint8_t> RefuseRequest(absl::Span<const uint8_t> request, const absl::Status& why,
                                   const reply_t& head);

}  // namespace splinemap
