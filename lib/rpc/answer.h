#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/rpc/messages.h"
#include "lib/wire/decode.h"
#include "splinemap/queryable_map.h"

namespace splinemap {

// The encoded reply to a message that RequestHeaderOf() takes for a request of a query, with what
// `map` says to it: an answer, or why there is none. Whatever the bytes are, of bounded size and
// work. `header` is complete but for revision and status. Empty for a message that is damaged.
std::vector<uint8_t> AnswerRequest(absl::Span<const uint8_t> request, const QueryableMap& map,
                                   const reply_t& header);

// The reply, without anything but its header, to any request, whose type alone is looked at.
std::vector<uint8_t> RefuseRequest(absl::Span<const uint8_t> request, const absl::Status& why,
                                   const reply_t& header);

// The channels of requests of queries.
std::vector<std::string> QueryChannels(const std::string& channel_prefix);

}  // namespace splinemap
