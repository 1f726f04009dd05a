#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/config/config.pb.h"
#include "lib/mapping/beam_model.h"
#include "lib/sensing/scan_queue.h"
#include "splinemap/fixed_pose2.h"
#include "splinemap/map_view.h"
#include "splinemap/sensor_options.h"

namespace splinemap {

// Reads a configuration file in Protobuf text format. Errors name file, line and column.
absl::StatusOr<config::Config> LoadConfig(const std::string& path);

// What a flag --scan says: CHANNEL[:PRESET][,option=value]..., each part as in config.proto.
absl::StatusOr<config::Scan> ParseScanFlag(const std::string& flag);

// The flag that ParseScanFlag() reads as `scan`.
std::string ScanFlagOf(const config::Scan& scan);

// What no single field shows: ranges against the knot interval, channels named twice, no channel to
// map from. InvalidArgument says what to do.
absl::Status CheckConfig(const config::Config& config);

// Names of presets, without "auto".
std::vector<std::string> PresetNames();

// The preset that fits the first message of a channel. `is_planar_lidar`: a
// bot_core.planar_lidar_t; otherwise Michigan's lidar_t, whose dialects differ in their beam times.
// Nothing where that takes a message with more beams.
std::optional<std::string> DetectPreset(bool is_planar_lidar, const RangeReadings& first_message);

// Explicit values of `scan` over those of `preset`, which is one of PresetNames().
SensorOptions SensorOptionsOf(const config::Scan& scan, const std::string& preset);
MapOptions MapOptionsOf(const config::Method& method);
BeamModelOptions BeamModelOptionsOf(const config::Method& method);
ScanQueueOptions ScanQueueOptionsOf(const config::Timing& timing);

// X_M,Y_M,YAW_DEG.
absl::StatusOr<FixedPose2> ParseFrame(const std::string& text);
// Of a configuration that was checked: from the frame of the poses to that of the map.
FixedPose2 FrameOf(const config::Config& config);

// Name and map file with their defaults filled in.
std::string RobotName(const config::Config& config);
std::string MapPath(const config::Config& config);

// Whether robots and their layers may be called that.
absl::Status CheckRobotName(const std::string& name);

}  // namespace splinemap
