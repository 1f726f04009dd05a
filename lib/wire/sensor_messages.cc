#include "lib/wire/sensor_messages.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/path2D_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lib/base/status.h"
#include "lib/wire/message_type.h"

namespace splinemap {
namespace {

// Sensors that look this far out of the horizontal plane make no planar map.
constexpr double kMaxTilt_rad = 10 * std::numbers::pi / 180;

absl::Status CheckUnitQuaternion(const char* type, const double q[4]) {
  const double squared_norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  if (std::abs(std::sqrt(squared_norm) - 1) < 0.01) return absl::OkStatus();
  return InvalidArgument("{} whose orientation is no unit quaternion: {} {} {} {}", type, q[0],
                         q[1], q[2], q[3]);
}

absl::Status UnknownType(absl::Span<const uint8_t> message, const std::string& expected) {
  return InvalidArgument("{}; {}", Describe(message), expected);
}

// Requires a message of this type.
template <typename Message>
absl::StatusOr<Message> DecodeSensor(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_RETURN_IF_ERROR(CheckTypeAndSize(*TypeOf(bytes), bytes));
  Message message{};
  if (message.decode(bytes.data(), 0, static_cast<int>(bytes.size())) < 0) {
    return InvalidArgument("{} that cannot be decoded", TypeName(*TypeOf(bytes)));
  }
  if constexpr (requires { message.utime; }) SPLINEMAP_RETURN_IF_ERROR(CheckUtime(message.utime));
  return message;
}

absl::StatusOr<RangeReadings> DecodePlanarLidar(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto message, DecodeSensor<bot_core::planar_lidar_t>(bytes));
  if (!std::isfinite(message.rad0) || !std::isfinite(message.radstep)) {
    return InvalidArgument("planar_lidar_t whose rad0 or radstep is not finite");
  }
  RangeReadings readings;
  readings.utime = Utime(message.utime);
  readings.bearings_rad.resize(message.ranges.size());
  for (size_t k = 0; k < message.ranges.size(); ++k) {
    readings.bearings_rad[k] = static_cast<float>(
        double{message.rad0} + static_cast<int32_t>(k) * double{message.radstep});
  }
  readings.ranges_m = std::move(message.ranges);
  return readings;
}

absl::StatusOr<RangeReadings> DecodeMichiganLidar(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(auto message, DecodeSensor<michigan::lidar_t>(bytes));
  RangeReadings readings;
  readings.utime = Utime(message.utime);
  readings.ranges_m = std::move(message.ranges);
  readings.bearings_rad = std::move(message.thetas);
  readings.beam_utimes.reserve(message.times.size());
  for (const int64_t utime : message.times) readings.beam_utimes.emplace_back(utime);
  return readings;
}

absl::StatusOr<TimedPose> DecodeBotCorePose(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto message, DecodeSensor<bot_core::pose_t>(bytes));
  const double* q = message.orientation;
  SPLINEMAP_RETURN_IF_ERROR(CheckUnitQuaternion("pose_t", q));
  const Eigen::Vector3d up_robot(2 * (q[1] * q[3] - q[0] * q[2]), 2 * (q[2] * q[3] + q[0] * q[1]),
                                 q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3]);
  return TimedPose{Utime(message.utime),
                   {{message.pos[0], message.pos[1]}, YawOfQuaternion(q[0], q[1], q[2], q[3])},
                   up_robot / std::sqrt(up_robot.squaredNorm())};
}

absl::StatusOr<TimedPose> DecodeMichiganPose(absl::Span<const uint8_t> bytes) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto message, DecodeSensor<michigan::pose_xyt_t>(bytes));
  TimedPose pose{Utime(message.utime),
                 {{double{message.x}, double{message.y}}, double{message.theta}}};
  const float farthest_m = std::max(std::abs(message.x), std::abs(message.y));
  pose.resolution_m = double{std::nextafter(farthest_m, HUGE_VALF)} - double{farthest_m};
  return pose;
}

}  // namespace

absl::StatusOr<RangeReadings> DecodeScan(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  if (type == MessageType::kPlanarLidar) return DecodePlanarLidar(message);
  if (type == MessageType::kLidar) return DecodeMichiganLidar(message);
  return UnknownType(message, "scans are bot_core.planar_lidar_t or Michigan's lidar_t");
}

absl::StatusOr<TimedPose> DecodePose(absl::Span<const uint8_t> message) {
  const auto type = TypeOf(message);
  absl::StatusOr<TimedPose> pose = type == MessageType::kPose ? DecodeBotCorePose(message)
                                   : type == MessageType::kPoseXyt
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

absl::StatusOr<std::vector<Pose2>> DecodePath(absl::Span<const uint8_t> message) {
  if (TypeOf(message) != MessageType::kPath2d)
    return UnknownType(message, "a path2D_t is expected");
  SPLINEMAP_ASSIGN_OR_RETURN(const auto path, DecodeSensor<michigan::path2D_t>(message));
  std::vector<Pose2> poses;
  for (const michigan::pose_xyt_t& pose : path.path) {
    if (!std::isfinite(pose.x) || !std::isfinite(pose.y) || !std::isfinite(pose.theta))
      return InvalidArgument("path2D_t with a pose that is not finite");
    poses.push_back({{pose.x, pose.y}, pose.theta});
  }
  if (poses.empty()) return InvalidArgument("path2D_t without a pose");
  return poses;
}

namespace {

// A rigid_transform_t of `what`, which has to be level.
absl::StatusOr<SensorMount> DecodeTransform(absl::Span<const uint8_t> message, const char* what,
                                            double max_distance_m) {
  if (TypeOf(message) != MessageType::kRigidTransform) {
    return UnknownType(message, "a bot_core.rigid_transform_t is expected");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const auto transform,
                             DecodeSensor<bot_core::rigid_transform_t>(message));
  const double* q = transform.quat;
  SPLINEMAP_RETURN_IF_ERROR(CheckUnitQuaternion("rigid_transform_t", q));
  // The z component of the z axis.
  const double turned_about_z = q[0] * q[0] + q[3] * q[3];
  const double turned_over = q[1] * q[1] + q[2] * q[2];
  const double up = (turned_about_z - turned_over) / (turned_about_z + turned_over);
  const SensorMount mount{.robot_T_sensor = {{transform.trans[0], transform.trans[1]},
                                             YawOfQuaternion(q[0], q[1], q[2], q[3])},
                          .is_upside_down = up < 0};
  if (!(mount.robot_T_sensor.position_m.norm() <= max_distance_m)) {
    return InvalidArgument("rigid_transform_t that puts {} at ({}, {}) m; {} m is the most", what,
                           transform.trans[0], transform.trans[1], max_distance_m);
  }
  if (const double tilt_rad = std::acos(std::min(std::abs(up), 1.0)); tilt_rad > kMaxTilt_rad) {
    return InvalidArgument(
        "rigid_transform_t that tilts {} by {:.0f} degrees; a planar map takes {:.0f}", what,
        tilt_rad * 180 / std::numbers::pi, kMaxTilt_rad * 180 / std::numbers::pi);
  }
  return mount;
}

}  // namespace

absl::StatusOr<SensorMount> DecodeSensorMount(absl::Span<const uint8_t> message) {
  return DecodeTransform(message, "the sensor", kMaxSensorDistance_m);
}

absl::StatusOr<Pose2> DecodeFrame(absl::Span<const uint8_t> message) {
  constexpr double kMax_m = 1e7;
  SPLINEMAP_ASSIGN_OR_RETURN(const SensorMount frame,
                             DecodeTransform(message, "the frame of the poses", kMax_m));
  if (frame.is_upside_down)
    return InvalidArgument("rigid_transform_t that turns the frame of the poses upside down");
  return frame.robot_T_sensor;
}

}  // namespace splinemap
