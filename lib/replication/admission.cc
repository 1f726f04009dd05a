#include "lib/replication/admission.h"

#include <algorithm>
#include <type_traits>
#include <utility>

#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/replication/protocol.h"

namespace splinemap {
namespace {

absl::Status Denied(const TrustedKey& key, const std::string& what, const std::string& layer) {
  return absl::PermissionDeniedError(
      fmt::format("signed by {}, whose key may not {} {}", key.name, what, PlainText(layer)));
}

// Whether the key may say it.
template <typename Message>
absl::Status CheckSpeaker(const TrustedKey& key, const Message& message) {
  using std::is_same_v;
  if constexpr (is_same_v<Message, layers_t>) {
    return key.answers || key.Maps(message.name) ? absl::OkStatus()
                                                 : Denied(key, "map", message.name);
  } else if constexpr (is_same_v<Message, settings_t> || is_same_v<Message, layer_pull_t> ||
                       is_same_v<Message, scan_pull_t>) {
    return absl::OkStatus();
  } else {
    const std::string& layer = message.layer.name;
    if (message.speaker == message.layer.session_nonce) {
      return key.Maps(layer) ? absl::OkStatus() : Denied(key, "map", layer);
    }
    return key.answers ? absl::OkStatus() : Denied(key, "answer for", layer);
  }
}

}  // namespace

Admission::Admission(std::string channel_prefix, std::shared_ptr<const KeyRing> keys,
                     uint64_t speaker)
    : channel_prefix_(std::move(channel_prefix)), keys_(std::move(keys)), speaker_(speaker) {}

std::optional<Admission::Message> Admission::Admit(absl::Span<const uint8_t> bytes) {
  absl::StatusOr<ReplicationMessage> decoded = DecodeReplication(bytes);
  if (!decoded.ok()) {
    ++malformed_;
    return std::nullopt;
  }
  if (SpeakerOf(*decoded) == speaker_) return std::nullopt;
  Message message{*std::move(decoded)};
  if (keys_ == nullptr) return message;
  if (const auto* pull = std::get_if<layer_pull_t>(&message.content);
      pull != nullptr && IsCall(*pull)) {
    message.answers = false;
    return message;
  }
  const absl::Status status = CheckSender(message.content, bytes, message.answers);
  if (status.ok()) {
    ++believed_;
    return message;
  }
  Disbelieved& disbelieved = disbelieved_[status.code()];
  ++disbelieved.count;
  disbelieved.why = ErrorText(status);
  return std::nullopt;
}

absl::Status Admission::CheckSender(ReplicationMessage& message, absl::Span<const uint8_t> bytes,
                                    bool& answers) {
  SPLINEMAP_ASSIGN_OR_RETURN(const TrustedKey* key,
                             keys_->SignerOf(ChannelOf(message, channel_prefix_), bytes));
  answers = key->answers;
  SPLINEMAP_RETURN_IF_ERROR(
      std::visit([&](const auto& m) { return CheckSpeaker(*key, m); }, message));
  auto* settings = std::get_if<settings_t>(&message);
  if (settings == nullptr || key->decides) return absl::OkStatus();
  for (const layer_settings_t& record : settings->layers) {
    passed_counter_ = std::max(passed_counter_, static_cast<uint64_t>(record.counter));
  }
  settings->layers.clear();
  settings->num_layers = 0;
  return absl::OkStatus();
}

}  // namespace splinemap
