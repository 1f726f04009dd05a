#pragma once

#include <cstdint>
#include <optional>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lcmtypes/splinemap/request_t.hpp"
#include "lib/wire/message_type.h"

namespace splinemap {

// Decodes what any process may have put on the bus as a message of lcmtypes/splinemap. Every count
// is checked against the bytes received before anything is allocated. InvalidArgument for another
// type, a wrong size, a time stamp that is negative or beyond the year 2200, and of the replication
// protocol for numbers that lib/layers/validity.h refuses. Whether nodes and tiles exist, and
// whether settings are valid, is not checked.
template <typename Message>
absl::StatusOr<Message> Decode(absl::Span<const uint8_t> message);

// The header of a request of any type, without decoding the rest; nothing for what is no request.
std::optional<request_t> RequestHeaderOf(absl::Span<const uint8_t> message);
// The header of a reply of any type, without decoding the rest; nothing for what is no reply or has
// a wrong size.
std::optional<reply_t> ReplyHeaderOf(absl::Span<const uint8_t> message);
// The id in the header of a reply of any type; nothing for what is no reply.
std::optional<int64_t> ReplyIdOf(absl::Span<const uint8_t> message);

}  // namespace splinemap
