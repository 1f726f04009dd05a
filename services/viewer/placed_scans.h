#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "lib/config/config.h"
#include "lib/sensing/scan_queue.h"
#include "splinemap/sensor_options.h"

namespace splinemap {

// Where a scan hit, and its sensor, in the frame of the poses.
struct ShownScan {
  Eigen::Vector2d sensor_m = Eigen::Vector2d::Zero();
  std::vector<Eigen::Vector2d> hits_m;
};

// Places scans by poses as the daemon does, to be looked at. Thread-compatible.
class PlacedScans {
 public:
  // `pose_channel` empty: no scan is placed.
  PlacedScans(std::vector<config::Scan> scans, std::string pose_channel);

  // One message of any channel; what cannot be used is left out.
  void HandleMessage(const std::string& channel, absl::Span<const uint8_t> message, Utime received);

  // Those that were placed since the last call, with their channels.
  std::vector<std::pair<std::string, ShownScan>> Take();

 private:
  struct Channel {
    config::Scan config;
    std::optional<SensorOptions> options;
    std::optional<SensorMount> mount;  // newest of its extrinsics_channel
  };

  void HandleScan(int index, absl::Span<const uint8_t> message, Utime received);

  std::vector<Channel> channels_;
  const std::string pose_channel_;
  ScanQueue queue_;
};

}  // namespace splinemap
