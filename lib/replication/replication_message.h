#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"

namespace splinemap {

// What owners, proxies and followers of layers send each other, and daemons say of them. Each type
// has a channel of its own.
using ReplicationMessage =
    std::variant<layer_digest_t, layer_updates_t, layer_listing_t, layer_pull_t, layer_scans_t,
                 scan_pull_t, settings_t, layers_t>;

// What the channel of digests ends in, after the prefix.
inline constexpr const char* kDigestChannel = "_DIGESTS";

// The channel of a message.
std::string ChannelOf(const ReplicationMessage& message, const std::string& channel_prefix);
// The channels of all types.
std::vector<std::string> ReplicationChannels(const std::string& channel_prefix);

// InvalidArgument for what is no such message, or a damaged one.
absl::StatusOr<ReplicationMessage> DecodeReplication(absl::Span<const uint8_t> message);

// Who sent it.
uint64_t SpeakerOf(const ReplicationMessage& message);
// The same for encoded bytes that may be anything; nothing where they are too few.
std::optional<uint64_t> SpeakerOf(absl::Span<const uint8_t> message);

std::vector<uint8_t> EncodeReplication(const ReplicationMessage& message);

}  // namespace splinemap
