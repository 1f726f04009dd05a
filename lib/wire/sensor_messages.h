#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/sensing/pose_buffer.h"
#include "splinemap/pose2.h"
#include "splinemap/scan.h"
#include "splinemap/sensor_options.h"

namespace splinemap {

// Decode what robots publish. Every count is checked against the bytes received before anything is
// allocated. InvalidArgument for another type, a wrong size, a time stamp that is negative or
// beyond the year 2200, a pose that is not finite or whose quaternion is not of unit length (to 1
// %), a sensor that is tilted by more than 10 degrees.

// A bot_core.planar_lidar_t or Michigan's lidar_t.
absl::StatusOr<RangeReadings> DecodeScan(absl::Span<const uint8_t> message);
// A bot_core.pose_t or Michigan's pose_xyt_t.
absl::StatusOr<TimedPose> DecodePose(absl::Span<const uint8_t> message);
// A path2D_t: at least one pose.
absl::StatusOr<std::vector<Pose2>> DecodePath(absl::Span<const uint8_t> message);
// A bot_core.rigid_transform_t that maps the sensor's frame into the robot's.
absl::StatusOr<SensorMount> DecodeSensorMount(absl::Span<const uint8_t> message);
// One that maps the frame of a robot's poses into that of the map.
absl::StatusOr<Pose2> DecodeFrame(absl::Span<const uint8_t> message);

}  // namespace splinemap
