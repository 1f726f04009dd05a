#include "lib/pipeline/mapper.h"

#include <cmath>
#include <utility>

#include "lib/base/status.h"

namespace splinemap {
namespace {

// So many scans without pose are a problem and no beginning or end.
constexpr int64_t kManyScans = 20;

// Poses further out are refused, so that no beam leaves the range of kMaxKnotIndex.
double MaxCoordinate(const MapOptions& options) {
  return 0.9 * kMaxKnotIndex * options.knot_interval_m;
}

}  // namespace

Mapper::Mapper(const config::Config& config, MapOptions map_options, Layer& layer)
    : pose_channel_(config.pose()),
      max_coordinate_m_(MaxCoordinate(map_options)),
      map_options_(map_options),
      layer_(layer),
      max_tiles_((size_t{config.service().max_map_mb()} << 20) / sizeof(Tile)),
      beam_model_(BeamModelOptionsOf(config.method()), map_options.knot_interval_m),
      queue_(ScanQueueOptionsOf(config.timing()), config.scan_size()) {
  channels_.push_back(pose_channel_);
  for (const config::Scan& scan : config.scan()) {
    channels_.push_back(scan.channel());
    scan_channels_.push_back({scan, std::nullopt});
    if (scan.preset() != "auto") {
      scan_channels_.back().options = SensorOptionsOf(scan, scan.preset());
    }
  }
}

void Mapper::HandleMessage(const std::string& channel, absl::Span<const uint8_t> message) {
  const auto count_message = [&] {
    ++counts_.messages_received;
    counts_.bytes_received += static_cast<int64_t>(message.size());
  };
  if (channel == pose_channel_) {
    count_message();
    HandlePose(message);
  }
  for (size_t k = 0; k < scan_channels_.size(); ++k) {
    if (channel != scan_channels_[k].config.channel()) continue;
    count_message();
    HandleScan(static_cast<int>(k), message);
  }
}

void Mapper::Flush() {
  queue_.Flush();
  MapReadyScans();
}

void Mapper::HandleScan(int channel, absl::Span<const uint8_t> message) {
  ++counts_.scans_received;
  ScanChannel& scan_channel = scan_channels_[channel];
  const std::string& name = scan_channel.config.channel();
  const absl::StatusOr<RangeReadings> readings = DecodeScan(message);
  if (!readings.ok()) {
    Drop(DropReason::kMalformedScan, name, ErrorText(readings.status()));
    return;
  }
  if (!scan_channel.options) {
    const std::optional<std::string> preset =
        DetectPreset(TypeOf(message) == MessageType::kPlanarLidar, *readings);
    if (!preset) {
      Drop(DropReason::kUnusableScan, name, "has too few beams to tell its preset");
      return;
    }
    scan_channel.options = SensorOptionsOf(scan_channel.config, *preset);
    notices_.push_back({false, fmt::format("{}: read with preset {}, told from the first message",
                                           name, *preset)});
  }
  absl::StatusOr<Scan> scan = PrepareScan(*readings, *scan_channel.options, channel);
  if (!scan.ok()) {
    Drop(DropReason::kUnusableScan, name, ErrorText(scan.status()));
    return;
  }
  queue_.AddScan(*std::move(scan));
  MapReadyScans();
}

void Mapper::HandlePose(absl::Span<const uint8_t> message) {
  ++counts_.poses_received;
  const absl::StatusOr<TimedPose> pose = DecodePose(message);
  if (!pose.ok()) {
    Drop(DropReason::kMalformedPose, pose_channel_, ErrorText(pose.status()));
    return;
  }
  if (const Eigen::Vector2d& p = pose->world_T_robot.position_m;
      p.cwiseAbs().maxCoeff() > max_coordinate_m_) {
    Drop(DropReason::kPoseOutOfRange, pose_channel_,
         fmt::format("pose at ({}, {}) m; {:.0f} m is the most", p.x(), p.y(), max_coordinate_m_));
    return;
  }
  queue_.AddPose(*pose);
  MapReadyScans();
}

void Mapper::MapReadyScans() {
  while (const std::optional<PlacedScan> scan = queue_.Next()) MapScan(*scan);
  NoticeQueueDrops();
}

void Mapper::MapScan(const PlacedScan& scan) {
  if (layer_.tiles().size() >= max_tiles_) {
    Drop(DropReason::kMapFull, scan_channels_[scan.channel].config.channel(),
         DropExplanation(DropReason::kMapFull));
    return;
  }
  beam_model_.Accumulate(scan.beams, scratch_);
  scratch_.CommitTo(layer_, map_options_.limits);
  ++counts_.scans_mapped;
  counts_.beams_mapped += static_cast<int64_t>(scan.beams.size());
  newest_scan_utime_ = scan.utime;
  without_pose_before_ = queue_.counts().drops[DropReason::kScanWithoutPose];
  if (std::exchange(is_lost_, false)) notices_.push_back({false, "scans have poses again"});
}

void Mapper::Drop(DropReason reason, const std::string& channel, const std::string& explanation) {
  if (counts_.drops[reason]++ == 0) {
    notices_.push_back(
        {true, fmt::format("dropped {} on {}: {}", DropName(reason), channel, explanation)});
  }
}

void Mapper::NoticeQueueDrops() {
  const ScanQueueCounts& counts = queue_.counts();
  for (int k = 0; k < kNumDropReasons; ++k) {
    const auto reason = static_cast<DropReason>(k);
    if (reason == DropReason::kScanWithoutPose) continue;  // a few are usual; see below
    if (counts.drops[reason] > 0 && noticed_.drops[reason] == 0) {
      notices_.push_back(
          {true, fmt::format("dropped {}: {}", DropName(reason), DropExplanation(reason))});
    }
  }
  const int64_t in_a_row = counts.drops[DropReason::kScanWithoutPose] - without_pose_before_;
  if (in_a_row >= kManyScans && !std::exchange(is_lost_, true)) {
    notices_.push_back({true, fmt::format("{} scans in a row without poses before and after them; "
                                          "does {} come, and share a clock with the scans?",
                                          in_a_row, pose_channel_)});
  }
  if (counts.time_jumps > 0 && noticed_.time_jumps == 0) {
    notices_.push_back({true, "message time jumped back (a log was rewound?); the map is kept"});
  }
  noticed_ = counts;
}

MapperCounts Mapper::counts() const {
  MapperCounts counts = counts_;
  counts.drops += queue_.counts().drops;
  return counts;
}

std::vector<Notice> Mapper::TakeNotices() { return std::exchange(notices_, {}); }

}  // namespace splinemap
