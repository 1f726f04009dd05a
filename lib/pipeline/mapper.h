#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "lib/config/config.h"
#include "lib/map/layer.h"
#include "lib/map/map.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "lib/sensing/drop_counts.h"
#include "lib/sensing/scan_queue.h"
#include "lib/wire/decode.h"

namespace splinemap {

// Totals since construction.
struct MapperCounts {
  int64_t messages_received = 0;
  int64_t bytes_received = 0;
  int64_t scans_received = 0;  // of them, messages on scan channels
  int64_t poses_received = 0;
  int64_t scans_mapped = 0;
  int64_t beams_mapped = 0;
  DropCounts drops;
};

// What a person should know. A problem wants something done about it.
struct Notice {
  bool is_problem = true;
  std::string text;
};

// From LCM messages to commits: decode, bring scans and poses together, accumulate, commit. The
// same messages in the same order make the same layer, in the daemon and offline.
// Thread-compatible.
class Mapper {
 public:
  // Requires CheckConfig(config).ok(). `layer` outlives the mapper.
  Mapper(const config::Config& config, MapOptions map_options, Layer& layer);

  // The channels to feed.
  const std::vector<std::string>& channels() const { return channels_; }

  // One message of any channel; what is none of channels() is ignored. What cannot be used is
  // dropped and counted.
  void HandleMessage(const std::string& channel, absl::Span<const uint8_t> message);

  // The end of input: maps what still can be placed.
  void Flush();

  MapperCounts counts() const;
  size_t scans_queued() const { return queue_.size(); }
  Utime newest_scan_utime() const { return newest_scan_utime_; }

  // What is new since the last call, each thing once: chosen presets, the first drop of each kind,
  // jumps in time; and each time that poses fail to come for many scans, or come again.
  std::vector<Notice> TakeNotices();

 private:
  struct ScanChannel {
    config::Scan config;
    std::optional<SensorOptions> options;  // known from the first message on
  };

  void HandleScan(int channel, absl::Span<const uint8_t> message);
  void HandlePose(absl::Span<const uint8_t> message);
  void MapReadyScans();
  void Drop(DropReason reason, const std::string& channel, const std::string& explanation);
  void MapScan(const PlacedScan& scan);
  void NoticeQueueDrops();

  std::vector<std::string> channels_;
  std::string pose_channel_;
  std::vector<ScanChannel> scan_channels_;
  double max_coordinate_m_;
  MapOptions map_options_;
  Layer& layer_;
  size_t max_tiles_;
  BeamModel beam_model_;
  ScanQueue queue_;
  ScanScratch scratch_;
  MapperCounts counts_;
  Utime newest_scan_utime_{0};
  ScanQueueCounts noticed_;          // counts of queue_ that were noticed
  int64_t without_pose_before_ = 0;  // scans without pose, when a scan was mapped last
  bool is_lost_ = false;             // many scans in a row had no pose
  std::vector<Notice> notices_;
};

}  // namespace splinemap
