#include "lib/wire/decode.h"

#include <cmath>
#include <limits>
#include <numbers>

#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/occupancy_grid_t.hpp"
#include "lcmtypes/michigan/path2D_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/status.h"
#include "lib/map/detail.h"
#include "lib/map/validity.h"

namespace splinemap {
namespace {

constexpr size_t kFingerprintBytes = 8;
// Sensors that look this far out of the horizontal plane make no planar map.
constexpr double kMaxTilt_rad = 10 * std::numbers::pi / 180;
constexpr size_t kRequestHeadBytes = 4 * 8;
constexpr int kMaxPulledNodes = 1000;  // of what followers ask for at once, several times
constexpr int64_t kMaxUtime = int64_t{230} * 365 * 86'400 * 1'000'000;

// Walks over the fields of a message without decoding them, to see whether its counts add up to its
// size: the generated decoders allocate what the counts claim.
class SizeWalk {
 public:
  explicit SizeWalk(absl::Span<const uint8_t> message) : rest_(message) {}

  void Skip(size_t bytes) {
    fits_ = fits_ && bytes <= rest_.size();
    if (fits_) rest_.remove_prefix(bytes);
  }

  size_t Count() {
    const absl::Span<const uint8_t> bytes = rest_;
    Skip(4);
    if (!fits_) return 0;
    const uint32_t count = (uint32_t{bytes[0]} << 24) | (uint32_t{bytes[1]} << 16) |
                           (uint32_t{bytes[2]} << 8) | bytes[3];
    if (count > std::numeric_limits<int32_t>::max()) fits_ = false;
    return count;
  }

  // Its length counts a closing 0, which the generated decoder takes off without looking.
  void String() {
    const size_t length = Count();
    if (length == 0) fits_ = false;
    Skip(length);
  }
  void Strings(size_t count) {
    for (size_t k = 0; fits_ && k < count; ++k) String();
  }

  bool fits() const { return fits_; }
  bool AtEnd() const { return fits_ && rest_.empty(); }

 private:
  absl::Span<const uint8_t> rest_;
  bool fits_ = true;
};

// Requires eight bytes or more.
uint64_t BigEndian64(absl::Span<const uint8_t> bytes) {
  uint64_t value = 0;
  for (size_t k = 0; k < 8; ++k) value = (value << 8) | bytes[k];
  return value;
}

void SkipLayerEpoch(SizeWalk& walk) {
  walk.String();  // name
  walk.Skip(3 * 8 + 2 * 1);
}

void SkipLayerDigest(SizeWalk& walk) {
  SkipLayerEpoch(walk);
  walk.Skip(4 + 8 + 8 + 2 * 4 + 4 * 8 + 4 + 8);
}

void SkipReplyHead(SizeWalk& walk) {
  walk.Skip(8);   // id
  walk.String();  // name
  walk.Skip(3 * 8 + 4);
  walk.String();  // status_text
}

bool HasRightSize(MessageType type, absl::Span<const uint8_t> message) {
  SizeWalk walk(message);
  walk.Skip(kFingerprintBytes);
  switch (type) {
    case MessageType::kPlanarLidar:
      walk.Skip(8);                 // utime
      walk.Skip(4 * walk.Count());  // ranges
      walk.Skip(4 * walk.Count());  // intensities
      walk.Skip(4 + 4);             // rad0, radstep
      break;
    case MessageType::kMichiganLidar:
      walk.Skip(8);
      walk.Skip((4 + 4 + 8 + 4) * walk.Count());  // ranges, thetas, times, intensities
      break;
    case MessageType::kPose:
      walk.Skip(8 + 8 * (3 + 3 + 4 + 3 + 3));
      break;
    case MessageType::kMichiganPose:
      walk.Skip(8 + 4 * 3);
      break;
    case MessageType::kRigidTransform:
      walk.Skip(8 + 8 * (3 + 4));
      break;
    case MessageType::kStatus: {
      walk.Skip(8);
      walk.String();  // name
      walk.Skip(8 * 3);
      walk.String();  // version
      walk.Skip(8 * 8);
      const size_t reasons = walk.Count();
      walk.Strings(reasons);
      walk.Skip(8 * reasons);
      const size_t problems = walk.Count();
      walk.Strings(problems);
      walk.Skip(8 * problems);
      walk.Skip(4 * 2 + 8 * 8);
      walk.String();  // last_problem
      break;
    }
    case MessageType::kLayerDigest:
      SkipLayerDigest(walk);
      break;
    case MessageType::kStandInDigest:
      walk.Skip(8);
      SkipLayerDigest(walk);
      break;
    case MessageType::kLayerUpdates:
      SkipLayerEpoch(walk);
      for (size_t left = walk.Count(); walk.fits() && left > 0; --left) {
        walk.Skip(2 * 4 + 3 * 8);
        walk.Skip(walk.Count());  // content
      }
      break;
    case MessageType::kLayerListing:
      SkipLayerEpoch(walk);
      walk.Skip(8);  // state
      for (size_t left = walk.Count(); walk.fits() && left > 0; --left) {
        walk.Skip(3 * 4);
        walk.Skip((1 + 8 + 8) * walk.Count());  // children
      }
      break;
    case MessageType::kLayerPull:
      SkipLayerEpoch(walk);
      walk.Skip(3 * 4 * walk.Count());  // nodes
      break;
    case MessageType::kControlRecords:
      walk.Skip(8 + 8);
      for (size_t left = walk.Count(); walk.fits() && left > 0; --left) {
        walk.String();  // name
        walk.Skip(8 + 2 * 1 + 2 * 4 + 3 * 8 + 3 * 8 + 1);
      }
      break;
    case MessageType::kLayers:
      walk.Skip(8);
      walk.String();  // name
      walk.Skip(8 + 8);
      walk.Strings(walk.Count());  // refused
      for (size_t left = walk.Count(); walk.fits() && left > 0; --left) {
        walk.String();  // name
        walk.Skip(3 * 8);
        walk.String();  // state
        walk.Skip(8 + 3 * 8 + 5 * 8 + 2 * 1 + 2 * 4 + 8);
      }
      break;
    case MessageType::kPointsRequest:
      walk.Skip(kRequestHeadBytes + 1);
      walk.Skip(2 * 8 * walk.Count());  // points
      break;
    case MessageType::kPointsReply:
      SkipReplyHead(walk);
      walk.Skip((3 * 8 + 1) * walk.Count());  // points
      walk.Skip(3 * 8 * walk.Count());        // hessians
      break;
    case MessageType::kRaysRequest:
      walk.Skip(kRequestHeadBytes + 8 + 1);
      walk.Skip(4 * 8 * walk.Count());  // rays
      break;
    case MessageType::kRaysReply:
      SkipReplyHead(walk);
      walk.Skip((1 + 8) * walk.Count());  // rays
      break;
    case MessageType::kSweepsRequest:
      walk.Skip(kRequestHeadBytes + 8 + 1);
      for (size_t left = walk.Count(); walk.fits() && left > 0; --left) {
        walk.Skip(8);
        walk.Skip(2 * 8 * walk.Count());  // vertices
      }
      break;
    case MessageType::kSweepsReply:
      SkipReplyHead(walk);
      walk.Skip((2 + 3 * 8) * walk.Count());  // sweeps
      break;
    case MessageType::kRasterRequest:
      walk.Skip(kRequestHeadBytes + 3 * 8 + 4 * 4);
      break;
    case MessageType::kRasterReply:
      SkipReplyHead(walk);
      walk.Skip(2 * walk.Count());  // cells
      break;
    case MessageType::kLikelihoodsRequest:
      walk.Skip(kRequestHeadBytes);
      walk.Skip(2 * 8 * walk.Count());  // hits
      walk.Skip(3 * 8 * walk.Count());  // poses
      break;
    case MessageType::kLikelihoodsReply:
      SkipReplyHead(walk);
      walk.Skip(8 * walk.Count());  // poses
      break;
    case MessageType::kDistancesRequest:
      walk.Skip(kRequestHeadBytes + 2 * 8);
      walk.Skip(2 * 8 * walk.Count());  // points
      break;
    case MessageType::kDistancesReply:
      SkipReplyHead(walk);
      walk.Skip(3 * 8 * walk.Count());  // points
      break;
    case MessageType::kCommandRequest:
      walk.Skip(kRequestHeadBytes);
      walk.String();  // command
      walk.Skip(8);
      break;
    case MessageType::kLayerCommandRequest:
      walk.Skip(kRequestHeadBytes);
      walk.String();  // command
      walk.String();  // name
      walk.Skip(2 * 8 + 2 * 4);
      break;
    case MessageType::kCommandReply:
      SkipReplyHead(walk);
      break;
  }
  return walk.AtEnd();
}

absl::Status CheckUtime(int64_t utime) {
  if (utime < 0 || utime > kMaxUtime) {
    return InvalidArgument("time stamp {} us is no plausible time", utime);
  }
  return absl::OkStatus();
}

absl::Status CheckUnitQuaternion(const char* type, const double q[4]) {
  const double squared_norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  if (std::abs(std::sqrt(squared_norm) - 1) < 0.01) return absl::OkStatus();
  return InvalidArgument("{} whose orientation is no unit quaternion: {} {} {} {}", type, q[0],
                         q[1], q[2], q[3]);
}

template <typename Message>
absl::StatusOr<Message> Decode(MessageType type, absl::Span<const uint8_t> message) {
  Message decoded{};
  if (!HasRightSize(type, message) ||
      decoded.decode(message.data(), 0, static_cast<int>(message.size())) < 0) {
    return InvalidArgument("{} whose counts do not fit its {} bytes", TypeName(type),
                           message.size());
  }
  if constexpr (requires { decoded.utime; }) {
    SPLINEMAP_RETURN_IF_ERROR(CheckUtime(decoded.utime));
  }
  return decoded;
}

absl::Status Check(const layer_epoch_t& layer) {
  SPLINEMAP_RETURN_IF_ERROR(CheckLayerId({layer.name, 0}));
  SPLINEMAP_RETURN_IF_ERROR(CheckEpoch({static_cast<uint64_t>(layer.incarnation), 0}));
  if (Detail{layer.detail_level, static_cast<Band>(layer.band)}.IsValid()) return absl::OkStatus();
  return InvalidArgument("level of detail {} and band {}, which do not exist", layer.detail_level,
                         layer.band);
}

absl::Status Check(const layer_digest_t& digest) {
  constexpr int kMaxRootLevel = 8;
  const auto is_control_point = [](int32_t value) {
    return value >= std::numeric_limits<ControlPoint>::min() &&
           value <= std::numeric_limits<ControlPoint>::max();
  };
  SPLINEMAP_RETURN_IF_ERROR(Check(digest.layer));
  SPLINEMAP_RETURN_IF_ERROR(CheckUtime(digest.utime));
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

absl::StatusOr<RangeReadings> DecodePlanarLidar(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto message,
                             Decode<bot_core::planar_lidar_t>(MessageType::kPlanarLidar, bytes));
  if (!std::isfinite(message.rad0) || !std::isfinite(message.radstep)) {
    return InvalidArgument("planar_lidar_t whose rad0 or radstep is not finite");
  }
  RangeReadings readings;
  readings.utime = Utime(message.utime);
  readings.bearings_rad.reserve(message.ranges.size());
  for (size_t k = 0; k < message.ranges.size(); ++k) {
    readings.bearings_rad.push_back(
        static_cast<float>(double{message.rad0} + static_cast<double>(k) * message.radstep));
  }
  readings.ranges_m = std::move(message.ranges);
  return readings;
}

absl::StatusOr<RangeReadings> DecodeMichiganLidar(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto message,
                             Decode<michigan::lidar_t>(MessageType::kMichiganLidar, bytes));
  RangeReadings readings;
  readings.utime = Utime(message.utime);
  readings.ranges_m = std::move(message.ranges);
  readings.bearings_rad = std::move(message.thetas);
  readings.beam_utimes.reserve(message.times.size());
  for (const int64_t utime : message.times) readings.beam_utimes.emplace_back(utime);
  return readings;
}

absl::StatusOr<TimedPose> DecodeBotCorePose(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto message,
                             Decode<bot_core::pose_t>(MessageType::kPose, bytes));
  const double* q = message.orientation;
  SPLINEMAP_RETURN_IF_ERROR(CheckUnitQuaternion("pose_t", q));
  return TimedPose{Utime(message.utime),
                   {{message.pos[0], message.pos[1]}, YawOfQuaternion(q[0], q[1], q[2], q[3])}};
}

absl::StatusOr<TimedPose> DecodeMichiganPose(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto message,
                             Decode<michigan::pose_xyt_t>(MessageType::kMichiganPose, bytes));
  return TimedPose{Utime(message.utime),
                   {{double{message.x}, double{message.y}}, double{message.theta}}};
}

std::optional<MessageType> TypeOfFingerprint(uint64_t fingerprint) {
  const auto hash = static_cast<int64_t>(fingerprint);
  if (hash == bot_core::planar_lidar_t::getHash()) return MessageType::kPlanarLidar;
  if (hash == bot_core::pose_t::getHash()) return MessageType::kPose;
  if (hash == michigan::lidar_t::getHash()) return MessageType::kMichiganLidar;
  if (hash == michigan::pose_xyt_t::getHash()) return MessageType::kMichiganPose;
  if (hash == bot_core::rigid_transform_t::getHash()) return MessageType::kRigidTransform;
  if (hash == status_t::getHash()) return MessageType::kStatus;
  if (hash == layer_digest_t::getHash()) return MessageType::kLayerDigest;
  if (hash == stand_in_digest_t::getHash()) return MessageType::kStandInDigest;
  if (hash == control_records_t::getHash()) return MessageType::kControlRecords;
  if (hash == layers_t::getHash()) return MessageType::kLayers;
  if (hash == layer_updates_t::getHash()) return MessageType::kLayerUpdates;
  if (hash == layer_listing_t::getHash()) return MessageType::kLayerListing;
  if (hash == layer_pull_t::getHash()) return MessageType::kLayerPull;
  if (hash == points_request_t::getHash()) return MessageType::kPointsRequest;
  if (hash == points_reply_t::getHash()) return MessageType::kPointsReply;
  if (hash == rays_request_t::getHash()) return MessageType::kRaysRequest;
  if (hash == rays_reply_t::getHash()) return MessageType::kRaysReply;
  if (hash == sweeps_request_t::getHash()) return MessageType::kSweepsRequest;
  if (hash == sweeps_reply_t::getHash()) return MessageType::kSweepsReply;
  if (hash == raster_request_t::getHash()) return MessageType::kRasterRequest;
  if (hash == raster_reply_t::getHash()) return MessageType::kRasterReply;
  if (hash == likelihoods_request_t::getHash()) return MessageType::kLikelihoodsRequest;
  if (hash == likelihoods_reply_t::getHash()) return MessageType::kLikelihoodsReply;
  if (hash == distances_request_t::getHash()) return MessageType::kDistancesRequest;
  if (hash == distances_reply_t::getHash()) return MessageType::kDistancesReply;
  if (hash == command_request_t::getHash()) return MessageType::kCommandRequest;
  if (hash == layer_command_request_t::getHash()) return MessageType::kLayerCommandRequest;
  if (hash == command_reply_t::getHash()) return MessageType::kCommandReply;
  return std::nullopt;
}

bool IsRequest(std::optional<MessageType> type) {
  switch (type.value_or(MessageType::kStatus)) {
    case MessageType::kPointsRequest:
    case MessageType::kRaysRequest:
    case MessageType::kSweepsRequest:
    case MessageType::kRasterRequest:
    case MessageType::kLikelihoodsRequest:
    case MessageType::kDistancesRequest:
    case MessageType::kCommandRequest:
    case MessageType::kLayerCommandRequest:
      return true;
    default:
      return false;
  }
}

bool IsReply(std::optional<MessageType> type) {
  switch (type.value_or(MessageType::kStatus)) {
    case MessageType::kPointsReply:
    case MessageType::kRaysReply:
    case MessageType::kSweepsReply:
    case MessageType::kRasterReply:
    case MessageType::kLikelihoodsReply:
    case MessageType::kDistancesReply:
    case MessageType::kCommandReply:
      return true;
    default:
      return false;
  }
}

absl::Status UnknownType(absl::Span<const uint8_t> message, const std::string& expected) {
  return InvalidArgument("{}; {}", Describe(message), expected);
}

// What a message says of a layer, with the type in front.
absl::Status InMessage(MessageType type, const absl::Status& status) {
  return status.ok() ? status : InvalidArgument("{} with {}", TypeName(type), ErrorText(status));
}

// For channels that take one type.
template <typename Message>
absl::StatusOr<Message> DecodeOnly(MessageType type, absl::Span<const uint8_t> message) {
  if (TypeOf(message) != type) {
    return UnknownType(message, fmt::format("expected a {}", TypeName(type)));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(Message decoded, Decode<Message>(type, message));
  if constexpr (requires { decoded.layer; }) {
    SPLINEMAP_RETURN_IF_ERROR(InMessage(type, Check(decoded.layer)));
  }
  return decoded;
}

}  // namespace

const char* TypeName(MessageType type) {
  switch (type) {
    case MessageType::kPlanarLidar:
      return "bot_core.planar_lidar_t";
    case MessageType::kPose:
      return "bot_core.pose_t";
    case MessageType::kMichiganLidar:
      return "lidar_t";
    case MessageType::kMichiganPose:
      return "pose_xyt_t";
    case MessageType::kRigidTransform:
      return "bot_core.rigid_transform_t";
    case MessageType::kStatus:
      return "splinemap.status_t";
    case MessageType::kLayerDigest:
      return "splinemap.layer_digest_t";
    case MessageType::kStandInDigest:
      return "splinemap.stand_in_digest_t";
    case MessageType::kControlRecords:
      return "splinemap.control_records_t";
    case MessageType::kLayers:
      return "splinemap.layers_t";
    case MessageType::kLayerUpdates:
      return "splinemap.layer_updates_t";
    case MessageType::kLayerListing:
      return "splinemap.layer_listing_t";
    case MessageType::kLayerPull:
      return "splinemap.layer_pull_t";
    case MessageType::kPointsRequest:
      return "splinemap.points_request_t";
    case MessageType::kPointsReply:
      return "splinemap.points_reply_t";
    case MessageType::kRaysRequest:
      return "splinemap.rays_request_t";
    case MessageType::kRaysReply:
      return "splinemap.rays_reply_t";
    case MessageType::kSweepsRequest:
      return "splinemap.sweeps_request_t";
    case MessageType::kSweepsReply:
      return "splinemap.sweeps_reply_t";
    case MessageType::kRasterRequest:
      return "splinemap.raster_request_t";
    case MessageType::kRasterReply:
      return "splinemap.raster_reply_t";
    case MessageType::kLikelihoodsRequest:
      return "splinemap.likelihoods_request_t";
    case MessageType::kLikelihoodsReply:
      return "splinemap.likelihoods_reply_t";
    case MessageType::kDistancesRequest:
      return "splinemap.distances_request_t";
    case MessageType::kDistancesReply:
      return "splinemap.distances_reply_t";
    case MessageType::kCommandRequest:
      return "splinemap.command_request_t";
    case MessageType::kLayerCommandRequest:
      return "splinemap.layer_command_request_t";
    case MessageType::kCommandReply:
      return "splinemap.command_reply_t";
  }
  return "unknown";
}

bool IsScan(MessageType type) {
  return type == MessageType::kPlanarLidar || type == MessageType::kMichiganLidar;
}

bool IsPose(MessageType type) {
  return type == MessageType::kPose || type == MessageType::kMichiganPose;
}

std::string FingerprintName(uint64_t fingerprint) {
  if (const auto type = TypeOfFingerprint(fingerprint)) return TypeName(*type);
  // Published for the Michigan stacks, never read.
  const auto hash = static_cast<int64_t>(fingerprint);
  if (hash == michigan::occupancy_grid_t::getHash()) return "occupancy_grid_t";
  if (hash == michigan::path2D_t::getHash()) return "path2D_t";
  return "";
}

std::string Describe(absl::Span<const uint8_t> message) {
  const auto fingerprint = FingerprintOf(message);
  if (!fingerprint) return fmt::format("{} bytes that are no LCM message", message.size());
  const std::string name = FingerprintName(*fingerprint);
  return fmt::format("a message of fingerprint {:#018x}, which is {}", *fingerprint,
                     name.empty() ? "of no type that splinemap knows" : name);
}

std::optional<uint64_t> FingerprintOf(absl::Span<const uint8_t> message) {
  if (message.size() < kFingerprintBytes) return std::nullopt;
  return BigEndian64(message);
}

Utime UtimeOf(absl::Span<const uint8_t> message) {
  return Utime(static_cast<int64_t>(BigEndian64(message.subspan(kFingerprintBytes))));
}

std::optional<MessageType> TypeOf(absl::Span<const uint8_t> message) {
  const auto fingerprint = FingerprintOf(message);
  return fingerprint ? TypeOfFingerprint(*fingerprint) : std::nullopt;
}

absl::StatusOr<RangeReadings> DecodeScan(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  if (type == MessageType::kPlanarLidar) return DecodePlanarLidar(message);
  if (type == MessageType::kMichiganLidar) return DecodeMichiganLidar(message);
  return UnknownType(message, "scans are bot_core.planar_lidar_t or Michigan's lidar_t");
}

absl::StatusOr<TimedPose> DecodePose(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  absl::StatusOr<TimedPose> pose = type == MessageType::kPose ? DecodeBotCorePose(message)
                                   : type == MessageType::kMichiganPose
                                       ? DecodeMichiganPose(message)
                                       : UnknownType(message,
                                                     "poses are bot_core.pose_t or "
                                                     "Michigan's pose_xyt_t");
  if (pose.ok() &&
      !(pose->world_T_robot.position_m.allFinite() && std::isfinite(pose->world_T_robot.yaw_rad))) {
    return InvalidArgument("pose that is not finite");
  }
  return pose;
}

absl::StatusOr<SensorMount> DecodeSensorMount(absl::Span<const uint8_t> message) {
  if (TypeOf(message) != MessageType::kRigidTransform) {
    return UnknownType(message, "extrinsics are a bot_core.rigid_transform_t");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const auto transform, Decode<bot_core::rigid_transform_t>(
                                                       MessageType::kRigidTransform, message));
  const double* q = transform.quat;
  SPLINEMAP_RETURN_IF_ERROR(CheckUnitQuaternion("rigid_transform_t", q));
  // The z component of the sensor's z axis.
  const double turned_about_z = q[0] * q[0] + q[3] * q[3];
  const double turned_over = q[1] * q[1] + q[2] * q[2];
  const double up = (turned_about_z - turned_over) / (turned_about_z + turned_over);
  const SensorMount mount{.robot_T_sensor = {{transform.trans[0], transform.trans[1]},
                                             YawOfQuaternion(q[0], q[1], q[2], q[3])},
                          .is_upside_down = up < 0};
  if (!(mount.robot_T_sensor.position_m.norm() <= kMaxSensorDistance_m)) {
    return InvalidArgument("rigid_transform_t that puts the sensor at ({}, {}) m; {} m is the most",
                           transform.trans[0], transform.trans[1], kMaxSensorDistance_m);
  }
  if (const double tilt_rad = std::acos(std::min(std::abs(up), 1.0)); tilt_rad > kMaxTilt_rad) {
    return InvalidArgument(
        "rigid_transform_t that tilts the sensor by {:.0f} degrees; a planar map takes {:.0f}",
        tilt_rad * 180 / std::numbers::pi, kMaxTilt_rad * 180 / std::numbers::pi);
  }
  return mount;
}

absl::StatusOr<status_t> DecodeStatus(absl::Span<const uint8_t> message) {
  return DecodeOnly<status_t>(MessageType::kStatus, message);
}

absl::StatusOr<layer_digest_t> DecodeLayerDigest(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto digest,
                             DecodeOnly<layer_digest_t>(MessageType::kLayerDigest, message));
  SPLINEMAP_RETURN_IF_ERROR(InMessage(MessageType::kLayerDigest, Check(digest)));
  return digest;
}

absl::StatusOr<stand_in_digest_t> DecodeStandInDigest(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto stand_in,
                             DecodeOnly<stand_in_digest_t>(MessageType::kStandInDigest, message));
  SPLINEMAP_RETURN_IF_ERROR(InMessage(MessageType::kStandInDigest, Check(stand_in.digest)));
  return stand_in;
}

absl::StatusOr<layer_updates_t> DecodeLayerUpdates(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto updates,
                             DecodeOnly<layer_updates_t>(MessageType::kLayerUpdates, message));
  for (const tile_update_t& tile : updates.tiles) {
    SPLINEMAP_RETURN_IF_ERROR(
        InMessage(MessageType::kLayerUpdates, CheckRevision(static_cast<uint64_t>(tile.revision))));
  }
  return updates;
}

absl::StatusOr<layer_listing_t> DecodeLayerListing(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto listing,
                             DecodeOnly<layer_listing_t>(MessageType::kLayerListing, message));
  for (const node_listing_t& node : listing.nodes) {
    for (const int64_t revision : node.revisions) {
      SPLINEMAP_RETURN_IF_ERROR(
          InMessage(MessageType::kLayerListing, CheckRevision(static_cast<uint64_t>(revision))));
    }
  }
  return listing;
}

absl::StatusOr<layer_pull_t> DecodeLayerPull(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto pull, DecodeOnly<layer_pull_t>(MessageType::kLayerPull, message));
  if (pull.num_nodes > kMaxPulledNodes) {
    return InvalidArgument("layer_pull_t of {} nodes; {} are the most", pull.num_nodes,
                           kMaxPulledNodes);
  }
  return pull;
}

absl::StatusOr<control_records_t> DecodeControlRecords(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto records,
                             DecodeOnly<control_records_t>(MessageType::kControlRecords, message));
  for (const layer_control_t& record : records.records) {
    SPLINEMAP_RETURN_IF_ERROR(
        InMessage(MessageType::kControlRecords, CheckLayerId({record.name, 0})));
  }
  return records;
}

absl::StatusOr<layers_t> DecodeLayers(absl::Span<const uint8_t> message) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto layers, DecodeOnly<layers_t>(MessageType::kLayers, message));
  for (const layer_status_t& layer : layers.layers) {
    SPLINEMAP_RETURN_IF_ERROR(InMessage(MessageType::kLayers, CheckLayerId({layer.name, 0})));
  }
  return layers;
}

template <typename Message>
absl::StatusOr<Message> DecodeRpc(absl::Span<const uint8_t> message) {
  const MessageType type = *TypeOfFingerprint(static_cast<uint64_t>(Message::getHash()));
  SPLINEMAP_ASSIGN_OR_RETURN(Message decoded, DecodeOnly<Message>(type, message));
  if constexpr (requires { decoded.head.name; }) {
    SPLINEMAP_RETURN_IF_ERROR(InMessage(type, CheckLayerId({decoded.head.name, 0})));
  }
  return decoded;
}
template absl::StatusOr<points_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<points_reply_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<rays_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<rays_reply_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<sweeps_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<sweeps_reply_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<raster_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<raster_reply_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<likelihoods_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<likelihoods_reply_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<distances_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<distances_reply_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<command_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<layer_command_request_t> DecodeRpc(absl::Span<const uint8_t>);
template absl::StatusOr<command_reply_t> DecodeRpc(absl::Span<const uint8_t>);

std::optional<request_t> RequestHeadOf(absl::Span<const uint8_t> message) {
  if (!IsRequest(TypeOf(message)) || message.size() < kFingerprintBytes + kRequestHeadBytes) {
    return std::nullopt;
  }
  const auto number = [&](size_t index) {
    return static_cast<int64_t>(BigEndian64(message.subspan(kFingerprintBytes + 8 * index)));
  };
  request_t head;
  head.client = number(0);
  head.id = number(1);
  head.query = number(2);
  head.daemon_nonce = number(3);
  return head;
}

std::optional<int64_t> ReplyIdOf(absl::Span<const uint8_t> message) {
  if (!IsReply(TypeOf(message)) || message.size() < kFingerprintBytes + 8) return std::nullopt;
  return static_cast<int64_t>(BigEndian64(message.subspan(kFingerprintBytes)));
}

}  // namespace splinemap
