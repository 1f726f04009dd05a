#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lcmtypes/message_table.h"
#include "splinemap/utime.h"

namespace splinemap {

// The bytes before the fields of every message.
inline constexpr size_t kFingerprintBytes = 8;

// What may follow the fields of splinemap's own messages: 8 bytes of a key and its signature, which
// lib/signing checks. Decoders of LCM leave out what they do not know.
inline constexpr size_t kSignatureBytes = 72;

// As users know it: "bot_core.planar_lidar_t".
const char* TypeName(MessageType type);
// The same by fingerprint; empty for one that is not known.
std::string FingerprintName(uint64_t fingerprint);

// The first eight bytes, or nothing where there are fewer.
std::optional<uint64_t> FingerprintOf(absl::Span<const uint8_t> message);
std::optional<MessageType> TypeOf(absl::Span<const uint8_t> message);
std::optional<MessageType> TypeOfFingerprint(uint64_t fingerprint);

bool IsScan(MessageType type);
bool IsPose(MessageType type);
// Of the RPCs: .._request_t and .._reply_t.
bool IsRequest(MessageType type);
bool IsReply(MessageType type);

// What a message is, for people: the type's name, or the fingerprint and what is known of it, or
// that it is no LCM message.
std::string Describe(absl::Span<const uint8_t> message);

// The 64 bits of a message's field that stands so many bytes behind the fingerprint. Requires that
// the message is that long.
int64_t FieldAt(absl::Span<const uint8_t> message, size_t offset);
// The time stamp, of a message with utime as its first field that was decoded.
Utime UtimeOf(absl::Span<const uint8_t> message);
// A time from 1970 to the year 2200.
inline constexpr int64_t kMaxUtime = int64_t{230} * 365 * 86'400 * 1'000'000;
absl::Status CheckUtime(int64_t utime);

// Whether a signature follows the fields, right or not.
bool IsSigned(absl::Span<const uint8_t> message);

// InvalidArgument for another type, or where the counts do not fit the size, with a signature or
// without.
absl::Status CheckTypeAndSize(MessageType type, absl::Span<const uint8_t> message);

}  // namespace splinemap
