#include "lib/replication/replication_message.h"

#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

const char* EndOfChannel(const layer_digest_t&) { return kDigestChannel; }
const char* EndOfChannel(const layer_updates_t&) { return "_UPDATES"; }
const char* EndOfChannel(const layer_listing_t&) { return "_LISTINGS"; }
const char* EndOfChannel(const layer_pull_t&) { return "_PULLS"; }
const char* EndOfChannel(const layer_scans_t&) { return "_SCANS"; }
const char* EndOfChannel(const scan_pull_t&) { return "_SCAN_PULLS"; }
const char* EndOfChannel(const settings_t&) { return "_SETTINGS"; }
const char* EndOfChannel(const layers_t&) { return "_LAYERS"; }

template <typename Message>
int64_t SpeakerOf(const Message& message) {
  return message.speaker;
}
int64_t SpeakerOf(const layers_t& message) { return message.daemon_nonce; }

template <typename Message>
absl::StatusOr<ReplicationMessage> Widen(absl::StatusOr<Message> message) {
  SPLINEMAP_RETURN_IF_ERROR(message.status());
  return ReplicationMessage(*std::move(message));
}

}  // namespace

std::string ChannelOf(const ReplicationMessage& message, const std::string& channel_prefix) {
  return channel_prefix + std::visit([](const auto& m) { return EndOfChannel(m); }, message);
}

std::vector<std::string> ReplicationChannels(const std::string& channel_prefix) {
  std::vector<std::string> channels;
  for (const ReplicationMessage& message :
       {ReplicationMessage(layer_digest_t()), ReplicationMessage(layer_updates_t()),
        ReplicationMessage(layer_listing_t()), ReplicationMessage(layer_pull_t()),
        ReplicationMessage(layer_scans_t()), ReplicationMessage(scan_pull_t()),
        ReplicationMessage(settings_t()), ReplicationMessage(layers_t())}) {
    channels.push_back(ChannelOf(message, channel_prefix));
  }
  return channels;
}

absl::StatusOr<ReplicationMessage> DecodeReplication(absl::Span<const uint8_t> message) {
  switch (TypeOf(message).value_or(MessageType::kStatus)) {
    case MessageType::kLayerDigest:
      return Widen(Decode<layer_digest_t>(message));
    case MessageType::kLayerUpdates:
      return Widen(Decode<layer_updates_t>(message));
    case MessageType::kLayerListing:
      return Widen(Decode<layer_listing_t>(message));
    case MessageType::kLayerPull:
      return Widen(Decode<layer_pull_t>(message));
    case MessageType::kLayerScans:
      return Widen(Decode<layer_scans_t>(message));
    case MessageType::kScanPull:
      return Widen(Decode<scan_pull_t>(message));
    case MessageType::kSettings:
      return Widen(Decode<settings_t>(message));
    case MessageType::kLayers:
      return Widen(Decode<layers_t>(message));
    default:
      return InvalidArgument("no message of the replication protocol");
  }
}

uint64_t SpeakerOf(const ReplicationMessage& message) {
  return static_cast<uint64_t>(std::visit([](const auto& m) { return SpeakerOf(m); }, message));
}

std::optional<uint64_t> SpeakerOf(absl::Span<const uint8_t> message) {
  constexpr size_t kTypeBytes = 8;
  if (message.size() < kTypeBytes + 8) return std::nullopt;
  uint64_t speaker = 0;  // the first field of all, big-endian
  for (const uint8_t byte : message.subspan(kTypeBytes, 8)) speaker = speaker << 8 | byte;
  return speaker;
}

std::vector<uint8_t> EncodeReplication(const ReplicationMessage& message) {
  return std::visit([](const auto& m) { return Encode(m); }, message);
}

}  // namespace splinemap
