// A message of one type, decoded and made ready as on a scan channel. The input is a byte that
// chooses sensor options, then the message after its fingerprint.

#include <vector>

#include "lcmtypes/bot_core/planar_lidar_t.hpp"
#include "lcmtypes/bot_core/pose_t.hpp"
#include "lcmtypes/bot_core/rigid_transform_t.hpp"
#include "lcmtypes/michigan/lidar_t.hpp"
#include "lcmtypes/michigan/pose_xyt_t.hpp"
#include "lcmtypes/splinemap/layer_digest_t.hpp"
#include "lcmtypes/splinemap/layer_listing_t.hpp"
#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/settings_t.hpp"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/wire/decode.h"
#include "lib/wire/sensor_messages.h"
#include "lib/wire/trajectory_parts.h"
#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/messages.h"

namespace splinemap::fuzz_message {

SensorOptions OptionsOf(uint8_t choice) {
  SensorOptions options;
  options.bearing_sign = (choice & 1) != 0 ? 1 : -1;
  options.use_beam_times = (choice & 2) != 0;
  options.no_return_is_free = (choice & 4) != 0;
  options.scan_duration = std::chrono::milliseconds((choice & 8) != 0 ? 2000 : -2000);
  options.time_offset = std::chrono::milliseconds((choice & 16) != 0 ? 10'000 : -10'000);
  options.range_min_m = (choice & 32) != 0 ? 0 : 10;
  options.range_max_m = (choice & 64) != 0 ? 20 : 1000;
  if ((choice & 128) != 0) {
    options.masks = {{0, 1}, {-3, 6.28}};
    options.every_nth_beam = 2;
    options.no_return_up_to_m = 10;
    options.mount.is_upside_down = true;
  }
  return options;
}

void Use(const std::vector<uint8_t>& message, const SensorOptions& options) {
  DecodePose(message).status().IgnoreError();
  Decode<status_t>(message).status().IgnoreError();
  Decode<layer_digest_t>(message).status().IgnoreError();
  Decode<settings_t>(message).status().IgnoreError();
  Decode<layers_t>(message).status().IgnoreError();
  Decode<layer_updates_t>(message).status().IgnoreError();
  Decode<layer_listing_t>(message).status().IgnoreError();
  Decode<layer_pull_t>(message).status().IgnoreError();
  Decode<layer_scans_t>(message).status().IgnoreError();
  Decode<scan_pull_t>(message).status().IgnoreError();
  DecodeFrame(message).status().IgnoreError();
  TrajectoryParts("robot").Add(message).status().IgnoreError();
  if (const auto mount = DecodeSensorMount(message); mount.ok()) {
    Require(mount->robot_T_sensor.position_m.norm() <= kMaxSensorDistance_m &&
                std::isfinite(mount->robot_T_sensor.yaw_rad),
            "sensors are on the robot");
  }
  const absl::StatusOr<RangeReadings> readings = DecodeScan(message);
  if (!readings.ok()) return;
  const absl::StatusOr<Scan> scan = PrepareScan(*readings, options, 0);
  if (!scan.ok()) return;
  for (const Beam& beam : scan->beams) {
    Require(std::isfinite(beam.range_m) && std::isfinite(beam.bearing_rad), "beams are finite");
    Require(beam.range_m >= 0 && beam.range_m <= static_cast<float>(options.range_max_m),
            "beams are within the range limits");
    Require(scan->first_beam <= beam.time_offset && beam.time_offset <= scan->last_beam,
            "beams are between the first and the last");
  }
}

template <typename Type>
void Run(FuzzInput input) {
  const SensorOptions options = OptionsOf(input.Byte());
  Use(MessageOf(Type::getHash(), input.Rest()), options);
}

const FuzzTarget targets[] = {
    {"planar_lidar", &Run<bot_core::planar_lidar_t>},
    {"pose", &Run<bot_core::pose_t>},
    {"michigan_lidar", &Run<michigan::lidar_t>},
    {"michigan_pose", &Run<michigan::pose_xyt_t>},
    {"rigid_transform", &Run<bot_core::rigid_transform_t>},
    {"status", &Run<status_t>},
    {"layer_digest", &Run<layer_digest_t>},
    {"settings", &Run<settings_t>},
    {"layers", &Run<layers_t>},
    {"layer_updates", &Run<layer_updates_t>},
    {"layer_listing", &Run<layer_listing_t>},
    {"layer_pull", &Run<layer_pull_t>},
    {"layer_scans", &Run<layer_scans_t>},
    {"scan_pull", &Run<scan_pull_t>},
    {"trajectory", &Run<trajectory_t>},
};

}  // namespace splinemap::fuzz_message
