#include "lib/wire/decode.h"

#include <cmath>
#include <limits>
#include <type_traits>

#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/distances_reply_t.hpp"
#include "lcmtypes/splinemap/distances_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/likelihoods_reply_t.hpp"
#include "lcmtypes/splinemap/likelihoods_request_t.hpp"
#include "lcmtypes/splinemap/points_reply_t.hpp"
#include "lcmtypes/splinemap/points_request_t.hpp"
#include "lcmtypes/splinemap/raster_reply_t.hpp"
#include "lcmtypes/splinemap/raster_request_t.hpp"
#include "lcmtypes/splinemap/rays_reply_t.hpp"
#include "lcmtypes/splinemap/rays_request_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/sweeps_reply_t.hpp"
#include "lcmtypes/splinemap/sweeps_request_t.hpp"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/base/status.h"
#include "lib/layers/validity.h"
#include "splinemap/fixed_pose2.h"
#include "splinemap/level_of_detail.h"

namespace splinemap {
namespace {

constexpr size_t kRequestHeaderBytes = 4 * 8;
constexpr int kMaxPulledNodes = 1000;  // of what followers ask for at once, several times
constexpr int kMaxPulledRanges = 64;
constexpr int kMaxScanParts = 2048;                    // of a few bytes less than a datagram
constexpr int64_t kMaxScanTime_us = int64_t{1} << 60;  // so that differences of times are some

// What a message has beside others; nothing for most.
template <typename Message>
absl::Status CheckContent(const Message&) {
  return absl::OkStatus();
}

absl::Status Check(const layer_ref_t& layer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckLayerId({layer.name, 0}));
  SPLINEMAP_RETURN_IF_ERROR(CheckSessionId({static_cast<uint64_t>(layer.session_number), 0}));
  const LevelOfDetail level{layer.level, static_cast<Statistic>(layer.statistic)};
  if (level.IsValid()) return absl::OkStatus();
  return InvalidArgument("level of detail {} and statistic {}, which do not exist", layer.level,
                         layer.statistic);
}

absl::Status CheckContent(const layer_digest_t& digest) {
  constexpr int kMaxRootLevel = 8;
  const auto is_control_point = [](int32_t value) {
    return value >= std::numeric_limits<ControlPoint>::min() &&
           value <= std::numeric_limits<ControlPoint>::max();
  };
  if (!is_control_point(digest.min_control_point) || !is_control_point(digest.max_control_point)) {
    return InvalidArgument("clamps of {} and {}, which no control point has",
                           digest.min_control_point, digest.max_control_point);
  }
  SPLINEMAP_RETURN_IF_ERROR(
      CheckMapOptions({digest.knot_interval_m,
                       {static_cast<ControlPoint>(digest.min_control_point),
                        static_cast<ControlPoint>(digest.max_control_point)}}));
  SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(digest.revision)));
  if (digest.state < 0 || digest.num_tiles < 0 || digest.root_level < 1 ||
      digest.root_level > kMaxRootLevel || !std::isfinite(digest.lag_s) || digest.lag_s < 0) {
    return InvalidArgument("state {}, {} tiles, root_level {} and lag_s {}, which cannot be",
                           digest.state, digest.num_tiles, digest.root_level, digest.lag_s);
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const layer_updates_t& updates) {
  for (const tile_update_t& tile : updates.tiles) {
    SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(tile.revision)));
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const layer_listing_t& listing) {
  for (const node_listing_t& node : listing.nodes) {
    for (const int64_t revision : node.revisions) {
      SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(revision)));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const layer_pull_t& pull) {
  if (pull.num_nodes <= kMaxPulledNodes) return absl::OkStatus();
  return InvalidArgument("{} nodes; at most {} are allowed", pull.num_nodes, kMaxPulledNodes);
}

absl::Status CheckContent(const layer_scans_t& scans) {
  SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(scans.oldest)));
  for (const scan_record_t& scan : scans.scans) {
    SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(scan.revision)));
    if (scan.utime < -kMaxScanTime_us || scan.utime > kMaxScanTime_us) {
      return InvalidArgument("a scan of {} us", scan.utime);
    }
    if (!FixedPose2{scan.robot_x, scan.robot_y, scan.robot_yaw}.IsValid()) {
      return InvalidArgument("a pose of ({}, {}), which cannot be", scan.robot_x, scan.robot_y);
    }
    if (scan.part < 0 || scan.part >= scan.num_parts || scan.num_parts > kMaxScanParts) {
      return InvalidArgument("part {} of {} of a scan", scan.part, scan.num_parts);
    }
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const scan_pull_t& pull) {
  if (pull.num_ranges > kMaxPulledRanges) {
    return InvalidArgument("{} ranges; at most {} are allowed", pull.num_ranges, kMaxPulledRanges);
  }
  for (int k = 0; k < pull.num_ranges; ++k) {
    SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(pull.first[k])));
    SPLINEMAP_RETURN_IF_ERROR(CheckRevision(static_cast<uint64_t>(pull.last[k])));
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const settings_t& settings) {
  for (const layer_settings_t& layer : settings.layers) {
    SPLINEMAP_RETURN_IF_ERROR(CheckLayerId({layer.name, 0}));
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const layers_t& layers) {
  for (const layer_status_t& layer : layers.layers) {
    SPLINEMAP_RETURN_IF_ERROR(CheckLayerId({layer.settings.name, 0}));
  }
  return absl::OkStatus();
}

absl::Status CheckContent(const trajectory_t& trajectory) {
  for (const int64_t utime : trajectory.pose_utime) SPLINEMAP_RETURN_IF_ERROR(CheckUtime(utime));
  return absl::OkStatus();
}

template <typename Message>
absl::Status CheckFields(const Message& message) {
  if constexpr (requires { message.utime; }) SPLINEMAP_RETURN_IF_ERROR(CheckUtime(message.utime));
  if constexpr (requires { message.layer; }) {
    // A pull of no layer asks for digests.
    const bool is_of_none = std::is_same_v<Message, layer_pull_t> && message.layer.name.empty();
    if (!is_of_none) SPLINEMAP_RETURN_IF_ERROR(Check(message.layer));
  }
  if constexpr (requires { message.header.name; }) {
    SPLINEMAP_RETURN_IF_ERROR(CheckLayerId({message.header.name, 0}));
  }
  return CheckContent(message);
}

}  // namespace

template <typename Message>
absl::StatusOr<Message> Decode(absl::Span<const uint8_t> bytes) {
  static const MessageType kType = *TypeOfFingerprint(static_cast<uint64_t>(Message::getHash()));
  SPLINEMAP_RETURN_IF_ERROR(CheckTypeAndSize(kType, bytes));
  Message message{};
  if (message.decode(bytes.data(), 0, static_cast<int>(bytes.size())) < 0) {
    return InvalidArgument("{} that cannot be decoded", TypeName(kType));
  }
  if (const absl::Status status = CheckFields(message); !status.ok()) {
    return InvalidArgument("{} with {}", TypeName(kType), ErrorText(status));
  }
  return message;
}

template absl::StatusOr<command_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<command_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<distances_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<distances_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layer_command_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layer_digest_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layer_listing_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layer_pull_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layer_scans_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layer_updates_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<layers_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<likelihoods_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<likelihoods_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<points_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<points_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<raster_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<raster_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<rays_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<rays_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<scan_pull_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<settings_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<status_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<sweeps_reply_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<sweeps_request_t> Decode(absl::Span<const uint8_t>);
template absl::StatusOr<trajectory_t> Decode(absl::Span<const uint8_t>);

std::optional<request_t> RequestHeaderOf(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  if (!type || !IsRequest(*type) || message.size() < kFingerprintBytes + kRequestHeaderBytes) {
    return std::nullopt;
  }
  request_t header;
  header.client = FieldAt(message, 0);
  header.id = FieldAt(message, 8);
  header.query = FieldAt(message, 16);
  header.daemon_nonce = FieldAt(message, 24);
  return header;
}

std::optional<reply_t> ReplyHeaderOf(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  if (!type || !IsReply(*type) || !CheckTypeAndSize(*type, message).ok()) return std::nullopt;
  reply_t header;
  const auto size = static_cast<int>(message.size() - kFingerprintBytes);
  if (header._decodeNoHash(message.data(), kFingerprintBytes, size) < 0) return std::nullopt;
  return header;
}

std::optional<int64_t> ReplyIdOf(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  if (!type || !IsReply(*type) || message.size() < kFingerprintBytes + 8) return std::nullopt;
  return FieldAt(message, 0);
}

}  // namespace splinemap
