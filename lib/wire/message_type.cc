#include "lib/wire/message_type.h"

#include <string_view>

#include "absl/container/flat_hash_map.h"
#include "lib/base/status.h"
#include "lib/wire/message_info.h"

namespace splinemap {
namespace {

const MessageInfo* InfoOf(uint64_t fingerprint) {
  static const auto& by_fingerprint = *[] {
    auto* infos = new absl::flat_hash_map<int64_t, const MessageInfo*>();
    for (const MessageInfo& info : MessageInfos()) infos->emplace(info.fingerprint, &info);
    return infos;
  }();
  const auto info = by_fingerprint.find(static_cast<int64_t>(fingerprint));
  return info == by_fingerprint.end() ? nullptr : info->second;
}

const MessageInfo& InfoOf(MessageType type) { return MessageInfos()[static_cast<size_t>(type)]; }

// Those of robots are none of splinemap's business.
bool CanBeSigned(MessageType type) {
  return std::string_view(InfoOf(type).name).starts_with("splinemap.");
}

// Nothing where the fields go beyond the end.
std::optional<size_t> BytesAfterFields(MessageType type, absl::Span<const uint8_t> message) {
  SizeWalk walk(message);
  walk.Skip(kFingerprintBytes);
  InfoOf(type).walk(walk);
  return walk.fits() ? std::optional(walk.bytes_left()) : std::nullopt;
}

}  // namespace

const char* TypeName(MessageType type) { return InfoOf(type).name; }

std::string FingerprintName(uint64_t fingerprint) {
  const MessageInfo* info = InfoOf(fingerprint);
  return info == nullptr ? "" : info->name;
}

std::optional<uint64_t> FingerprintOf(absl::Span<const uint8_t> message) {
  if (message.size() < kFingerprintBytes) return std::nullopt;
  uint64_t fingerprint = 0;
  for (const uint8_t byte : message.first(kFingerprintBytes)) fingerprint = fingerprint << 8 | byte;
  return fingerprint;
}

std::optional<MessageType> TypeOf(absl::Span<const uint8_t> message) {
  const auto fingerprint = FingerprintOf(message);
  return fingerprint ? TypeOfFingerprint(*fingerprint) : std::nullopt;
}

std::optional<MessageType> TypeOfFingerprint(uint64_t fingerprint) {
  const MessageInfo* info = InfoOf(fingerprint);
  return info == nullptr ? std::nullopt : std::optional(info->type);
}

bool IsScan(MessageType type) {
  return type == MessageType::kPlanarLidar || type == MessageType::kLidar;
}

bool IsPose(MessageType type) {
  return type == MessageType::kPose || type == MessageType::kPoseXyt;
}

bool IsRequest(MessageType type) {
  return std::string_view(TypeName(type)).ends_with("_request_t");
}

bool IsReply(MessageType type) { return std::string_view(TypeName(type)).ends_with("_reply_t"); }

std::string Describe(absl::Span<const uint8_t> message) {
  const auto fingerprint = FingerprintOf(message);
  if (!fingerprint) return fmt::format("{} bytes that are no LCM message", message.size());
  const std::string name = FingerprintName(*fingerprint);
  return fmt::format("a message of fingerprint {:#018x}, which is {}", *fingerprint,
                     name.empty() ? "of no type that splinemap knows" : name);
}

int64_t FieldAt(absl::Span<const uint8_t> message, size_t offset) {
  return static_cast<int64_t>(*FingerprintOf(message.subspan(kFingerprintBytes + offset)));
}

Utime UtimeOf(absl::Span<const uint8_t> message) { return Utime(FieldAt(message, 0)); }

absl::Status CheckUtime(int64_t utime) {
  if (utime >= 0 && utime <= kMaxUtime) return absl::OkStatus();
  constexpr int64_t kBeginOf2000_ns = 946'684'800'000'000'000;
  if (utime > kBeginOf2000_ns) {
    return InvalidArgument("time stamp {}, which seems to be nanoseconds; messages have us", utime);
  }
  return InvalidArgument("time stamp {} us is no plausible time", utime);
}

bool IsSigned(absl::Span<const uint8_t> message) {
  const std::optional<MessageType> type = TypeOf(message);
  return type && CanBeSigned(*type) && BytesAfterFields(*type, message) == kSignatureBytes;
}

absl::Status CheckTypeAndSize(MessageType type, absl::Span<const uint8_t> message) {
  if (TypeOf(message) != type) {
    return InvalidArgument("{}; expected a {}", Describe(message), TypeName(type));
  }
  const std::optional<size_t> rest = BytesAfterFields(type, message);
  if (rest == 0 || (rest == kSignatureBytes && CanBeSigned(type))) return absl::OkStatus();
  return InvalidArgument("{} whose counts do not fit its {} bytes", TypeName(type), message.size());
}

}  // namespace splinemap
