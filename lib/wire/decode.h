#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lcmtypes/splinemap/command_reply_t.hpp"
#include "lcmtypes/splinemap/command_request_t.hpp"
#include "lcmtypes/splinemap/control_records_t.hpp"
#include "lcmtypes/splinemap/distances_reply_t.hpp"
#include "lcmtypes/splinemap/distances_request_t.hpp"
#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
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
#include "lcmtypes/splinemap/stand_in_digest_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/sweeps_reply_t.hpp"
#include "lcmtypes/splinemap/sweeps_request_t.hpp"
#include "lib/sensing/pose_buffer.h"
#include "lib/sensing/scan.h"
#include "lib/sensing/sensor_options.h"

namespace splinemap {

// The types of message that splinemap reads. Each stands for a family: an LCM fingerprint covers
// member names and types, not the names of struct and package.
enum class MessageType {
  kPlanarLidar,
  kPose,
  kMichiganLidar,
  kMichiganPose,
  kRigidTransform,
  kStatus,
  kLayerDigest,
  kStandInDigest,
  kLayerUpdates,
  kLayerListing,
  kLayerPull,
  kControlRecords,
  kLayers,
  kPointsRequest,
  kPointsReply,
  kRaysRequest,
  kRaysReply,
  kSweepsRequest,
  kSweepsReply,
  kRasterRequest,
  kRasterReply,
  kLikelihoodsRequest,
  kLikelihoodsReply,
  kDistancesRequest,
  kDistancesReply,
  kCommandRequest,
  kLayerCommandRequest,
  kCommandReply
};

// As users know it: "bot_core.planar_lidar_t", ...
const char* TypeName(MessageType type);
bool IsScan(MessageType type);
bool IsPose(MessageType type);

// The name of a type by its fingerprint, also of some that splinemap does not read; empty for one
// that is not known.
std::string FingerprintName(uint64_t fingerprint);

// What a message is, for people: the type's name, or the fingerprint and what is known of it, or
// that it is no LCM message.
std::string Describe(absl::Span<const uint8_t> message);

// The first eight bytes, or nothing where there are fewer.
std::optional<uint64_t> FingerprintOf(absl::Span<const uint8_t> message);
std::optional<MessageType> TypeOf(absl::Span<const uint8_t> message);
// The time stamp, of a scan, pose, transform or status that one of the functions below has decoded.
Utime UtimeOf(absl::Span<const uint8_t> message);

// Decode what any process may have put on the bus. Every count is checked against the bytes
// received before anything is allocated. InvalidArgument in words for another type, a wrong size, a
// time stamp that is negative or beyond the year 2200, a pose that is not finite or whose
// quaternion is not of unit length (to 1 %), a sensor that is tilted by more than 10 degrees.
absl::StatusOr<RangeReadings> DecodeScan(absl::Span<const uint8_t> message);
absl::StatusOr<TimedPose> DecodePose(absl::Span<const uint8_t> message);
// A bot_core.rigid_transform_t that maps the sensor's frame into the robot's.
absl::StatusOr<SensorMount> DecodeSensorMount(absl::Span<const uint8_t> message);
absl::StatusOr<status_t> DecodeStatus(absl::Span<const uint8_t> message);
// What owners and followers of layers say, with numbers as map/validity.h allows them; that nodes
// and tiles exist is not checked.
absl::StatusOr<layer_digest_t> DecodeLayerDigest(absl::Span<const uint8_t> message);
absl::StatusOr<stand_in_digest_t> DecodeStandInDigest(absl::Span<const uint8_t> message);
absl::StatusOr<layer_updates_t> DecodeLayerUpdates(absl::Span<const uint8_t> message);
absl::StatusOr<layer_listing_t> DecodeLayerListing(absl::Span<const uint8_t> message);
absl::StatusOr<layer_pull_t> DecodeLayerPull(absl::Span<const uint8_t> message);
// What everybody tells of decisions about layers; that records are valid is not checked.
absl::StatusOr<control_records_t> DecodeControlRecords(absl::Span<const uint8_t> message);
absl::StatusOr<layers_t> DecodeLayers(absl::Span<const uint8_t> message);
// What clients ask and daemons reply; see lib/rpc for what it means. Specialized for each
// .._request_t and .._reply_t above.
template <typename Message>
absl::StatusOr<Message> DecodeRpc(absl::Span<const uint8_t> message);
// The head of a request of any type, without decoding the rest; nothing for what is no request.
std::optional<request_t> RequestHeadOf(absl::Span<const uint8_t> message);
// What the head of a reply of any type begins with; nothing for what is no reply.
std::optional<int64_t> ReplyIdOf(absl::Span<const uint8_t> message);

}  // namespace splinemap
