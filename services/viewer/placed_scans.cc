#include "services/viewer/placed_scans.h"

#include "lib/wire/message_type.h"
#include "lib/wire/sensor_messages.h"

namespace splinemap {

PlacedScans::PlacedScans(std::vector<config::Scan> scans, std::string pose_channel)
    : pose_channel_(std::move(pose_channel)),
      queue_(ScanQueueOptions(), static_cast<int>(scans.size())) {
  for (config::Scan& scan : scans) channels_.push_back({std::move(scan), {}, {}});
}

void PlacedScans::HandleMessage(const std::string& channel, absl::Span<const uint8_t> message,
                                Utime received) {
  if (channels_.empty() || pose_channel_.empty()) return;
  if (channel == pose_channel_) {
    if (const auto pose = DecodePose(message); pose.ok()) queue_.AddPose(*pose);
  }
  for (size_t k = 0; k < channels_.size(); ++k) {
    Channel& scans = channels_[k];
    if (channel == scans.config.channel()) HandleScan(static_cast<int>(k), message, received);
    if (channel == scans.config.extrinsics_channel()) {
      if (const auto mount = DecodeSensorMount(message); mount.ok()) scans.mount = *mount;
    }
  }
}

void PlacedScans::HandleScan(int index, absl::Span<const uint8_t> message, Utime received) {
  Channel& channel = channels_[index];
  absl::StatusOr<RangeReadings> readings = DecodeScan(message);
  if (!readings.ok()) return;
  if (!channel.options) {
    std::string preset = channel.config.preset();
    if (preset == "auto") {
      preset = DetectPreset(TypeOf(message) == MessageType::kPlanarLidar, *readings).value_or("");
      if (preset.empty()) return;
    }
    channel.options = SensorOptionsOf(channel.config, preset);
  }
  SensorOptions& options = *channel.options;
  if (channel.config.has_extrinsics_channel()) {
    if (!channel.mount) return;
    options.mount = *channel.mount;
  }
  if (options.stamp_is_receipt) *readings = At(*std::move(readings), received);
  if (absl::StatusOr<Scan> scan = PrepareScan(*readings, options, index); scan.ok())
    queue_.AddScan(*std::move(scan));
}

std::vector<std::pair<std::string, ShownScan>> PlacedScans::Take() {
  std::vector<std::pair<std::string, ShownScan>> taken;
  PlacedScan placed;
  while (const std::optional<PosedScan> posed = queue_.Next()) {
    Place(*posed, {}, placed);
    ShownScan scan;
    if (!placed.beams.empty()) scan.sensor_m = placed.beams.front().origin_world_m;
    for (const PlacedBeam& beam : placed.beams) {
      if (beam.hit)
        scan.hits_m.push_back(beam.origin_world_m + beam.range_m * beam.direction_world);
    }
    taken.emplace_back(channels_[placed.channel].config.channel(), std::move(scan));
  }
  return taken;
}

}  // namespace splinemap
