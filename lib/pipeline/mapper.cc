#include "lib/pipeline/mapper.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "lib/base/status.h"
#include "lib/diagnosis/pose_oddities.h"
#include "lib/wire/sensor_messages.h"

namespace splinemap {
namespace {

// So many scans in a row without pose are a problem and no beginning or end.
constexpr int kManyScans = 20;

// What the flags are tried on, once in the first seconds. A tenth of a second of work.
constexpr size_t kDriveScans = 40;
constexpr size_t kDriveBeams = 90;
// Time stamps so far apart are not those of one clock.
constexpr int64_t kOtherClock_ms = 1000;
// A millisecond of work or two, so that neither thread often waits for the other, and what is
// prepared is still in caches.
constexpr size_t kScansBeside = 32;

}  // namespace

Mapper::Mapper(const config::Config& config, MapOptions map_options, Layer& layer,
               ScanArchive archive)
    : pose_channel_(config.pose()),
      max_coordinate_m_(ScanFolder::MaxCoordinate_m(map_options)),
      queue_(ScanQueueOptionsOf(config.timing()), config.scan_size()),
      noticed_(queue_.counts()),
      builder_(config, map_options, layer, std::move(archive), findings_) {
  if (!pose_channel_.empty()) channels_.push_back(pose_channel_);
  for (const config::Scan& scan : config.scan()) {
    channels_.push_back(scan.channel());
    ScanChannel& channel = scan_channels_.emplace_back();
    channel.config = scan;
    channel.drive = std::make_unique<DriveCollector>(kDriveScans, kDriveBeams);
    if (scan.has_extrinsics_channel()) channels_.push_back(scan.extrinsics_channel());
  }
  std::sort(channels_.begin(), channels_.end());
  channels_.erase(std::unique(channels_.begin(), channels_.end()), channels_.end());
}

void Mapper::HandleMessage(const std::string& channel, absl::Span<const uint8_t> message,
                           Utime received) {
  if (!std::binary_search(channels_.begin(), channels_.end(), channel)) return;
  ++counts_.messages_received;
  counts_.bytes_received += static_cast<int64_t>(message.size());
  if (channel == pose_channel_) HandlePose(message);
  for (size_t k = 0; k < scan_channels_.size(); ++k) {
    ScanChannel& scan_channel = scan_channels_[k];
    if (channel == scan_channel.config.channel())
      HandleScan(static_cast<int>(k), message, received);
    if (channel == scan_channel.config.extrinsics_channel()) {
      HandleExtrinsics(scan_channel, message);
    }
  }
}

void Mapper::Flush() {
  queue_.Flush();
  MapReadyScans();
  Settled();
  // A short drive is better than none.
  for (size_t k = 0; k < scan_channels_.size(); ++k) {
    if (scan_channels_[k].drive && scan_channels_[k].options) TryOtherFlags(static_cast<int>(k));
  }
}

void Mapper::HandleScan(int channel, absl::Span<const uint8_t> message, Utime received) {
  ++counts_.scans_received;
  ScanChannel& scan_channel = scan_channels_[channel];
  const std::string& name = scan_channel.config.channel();
  const std::optional<MessageType> type = TypeOf(message);
  absl::StatusOr<RangeReadings> readings = DecodeScan(message);
  if (!readings.ok()) {
    Settled().Drop(
        type && IsScan(*type) ? DropReason::kMalformedScan : DropReason::kWrongTypeOfScan, name,
        ErrorText(readings.status()));
    return;
  }
  counts_.beams_received += std::ssize(readings->ranges_m);
  if (!ChooseOptions(scan_channel, *type, *readings)) return;
  CheckReadings(scan_channel, *readings);
  SensorOptions& options = *scan_channel.options;
  if (options.stamp_is_receipt) *readings = At(*std::move(readings), received);
  if (scan_channel.config.has_extrinsics_channel()) {
    if (!scan_channel.mount) {
      Settled().Drop(DropReason::kNoExtrinsics, name, DropExplanation(DropReason::kNoExtrinsics));
      return;
    }
    options.mount = *scan_channel.mount;
  }
  absl::StatusOr<Scan> scan = PrepareScan(*readings, options, channel);
  if (!scan.ok()) {
    Settled().Drop(DropReason::kUnusableScan, name, ErrorText(scan.status()));
    return;
  }
  if (options.use_beam_times && readings->beam_utimes.size() > 1 &&
      !HaveUsefulBeamTimes(*readings)) {
    Settled().Find(
        Problem::kUselessBeamTimes, name,
        "the beam times of its scans differ by less than 10 ms; if the sensor is slower, set "
        "beam_times=false and scan_duration_ms, as preset michigan_2017 does");
  }
  if (scan_channel.drive) {
    scan_channel.drive->AddScan(*std::move(readings), options.time_offset);
    TryFlagsOnceFull(channel);
  }
  scan_channel.newest_utime = scan->utime;
  queue_.AddScan(*std::move(scan));
  MapReadyScans();
}

bool Mapper::ChooseOptions(ScanChannel& channel, MessageType type, const RangeReadings& readings) {
  if (channel.options && channel.type == type) return true;
  const std::string& name = channel.config.channel();
  std::string& preset = channel.detected_presets[type];
  if (channel.config.preset() != "auto") {
    preset = channel.config.preset();
  } else if (preset.empty()) {
    preset = DetectPreset(type == MessageType::kPlanarLidar, readings).value_or("");
    if (preset.empty()) {
      Settled().Drop(DropReason::kUnusableScan, name, "has too few beams to tell its preset");
      return false;
    }
    Settled().notices.Add(false, fmt::format("preset {} {}", name, preset),
                          fmt::format("{}: {} is read with preset {}, told from the first message",
                                      name, TypeName(type), preset));
  }
  channel.type = type;
  channel.preset = preset;
  channel.options = SensorOptionsOf(channel.config, preset);
  return true;
}

void Mapper::HandleExtrinsics(ScanChannel& channel, absl::Span<const uint8_t> message) {
  const absl::StatusOr<SensorMount> mount = DecodeSensorMount(message);
  if (!mount.ok()) {
    Settled().Drop(DropReason::kMalformedExtrinsics, channel.config.extrinsics_channel(),
                   ErrorText(mount.status()));
    return;
  }
  channel.mount = *mount;
}

void Mapper::HandlePose(absl::Span<const uint8_t> message) {
  ++counts_.poses_received;
  const absl::StatusOr<TimedPose> pose = DecodePose(message);
  if (!pose.ok()) {
    const auto type = TypeOf(message);
    Settled().Drop(
        type && IsPose(*type) ? DropReason::kMalformedPose : DropReason::kWrongTypeOfPose,
        pose_channel_, ErrorText(pose.status()));
    return;
  }
  if (const Eigen::Vector2d& p = pose->world_T_robot.position_m;
      p.cwiseAbs().maxCoeff() > max_coordinate_m_) {
    Settled().Drop(
        DropReason::kPoseOutOfRange, pose_channel_,
        fmt::format("pose at ({}, {}) m; {:.0f} m is the most", p.x(), p.y(), max_coordinate_m_));
    return;
  }
  if (pose->resolution_m > kCoarsePose_m && !std::exchange(poses_are_coarse_, true)) {
    Settled().Find(Problem::kCoarsePoses, pose_channel_, CoarsePoses(*pose));
  }
  newest_pose_utime_ = pose->utime;
  queue_.AddPose(*pose);
  for (size_t k = 0; k < scan_channels_.size(); ++k) {
    if (!scan_channels_[k].drive) continue;
    scan_channels_[k].drive->AddPose(*pose);
    TryFlagsOnceFull(static_cast<int>(k));
  }
  MapReadyScans();
}

void Mapper::MapReadyScans() {
  while (std::optional<PosedScan> scan = queue_.Next()) {
    const SensorOptions& options = *scan_channels_[scan->channel].options;
    LayerBuilder::Item& item = beside_ ? beside_->Next() : item_;
    item.scan = *std::move(scan);
    item.min_travel_m = options.min_travel_m;
    item.min_turn_rad = options.min_turn_rad;
    item.is_placed = item.has_lines = false;
    if (beside_) {
      builder_.Prepare(item);
      beside_->Add();
    } else {
      builder_.Map(item);
    }
  }
  NoticeQueueDrops();
}

void Mapper::MapBeside() {
  beside_.emplace(kScansBeside, [this](LayerBuilder::Item& item) { builder_.Map(item); });
}

Findings& Mapper::Settled() {
  if (beside_) beside_->Wait();
  return findings_;
}

void Mapper::TryFlagsOnceFull(int channel) {
  if (scan_channels_[channel].drive->full()) TryOtherFlags(channel);
}

void Mapper::TryOtherFlags(int index) {
  ScanChannel& channel = scan_channels_[index];
  const std::unique_ptr<DriveCollector> drive = std::move(channel.drive);
  const auto proposal = SearchFlags(drive->sample(), *channel.options);
  Findings& findings = Settled();
  if (!proposal || proposal->spread > kClearlySharper * proposal->spread_given) {
    builder_.SetFlagsTried(index, "");
    return;
  }
  const std::string flag = ScanFlagOf(ScanWith(channel.config, channel.preset, proposal->options));
  const std::string better_options =
      proposal->is_time_beyond
          ? fmt::format(
                "its scans and the poses of {} seem to be more than a second apart; set or "
                "correct time_offset_ms",
                pose_channel_)
          : fmt::format(
                "read otherwise it gives a sharper map: hits lie in {:.0f} cells of 5 cm, "
                "and in {:.0f} as it is read now. Try --scan {}",
                proposal->spread, proposal->spread_given, flag);
  builder_.SetFlagsTried(index, better_options);
  findings.Find(Problem::kOptionsDisagree, channel.config.channel(), better_options);
}

void Mapper::CheckReadings(ScanChannel& channel, const RangeReadings& readings) {
  constexpr int64_t kChecked = 50;  // scans
  channel.readings.Add(readings);
  const int64_t scans = channel.readings.scans();
  if (scans != ReadingStatistics::kMinScans && scans % kChecked != 0) return;
  const auto complaint = channel.readings.Complain(channel.options->range_max_m);
  if (!complaint) return;
  std::string text = complaint->text;
  if (complaint->right_range_max_m) {
    config::Scan right = channel.config;
    right.set_range_max_m(*complaint->right_range_max_m);
    text += fmt::format(", as in --scan {}", ScanFlagOf(right));
  }
  Settled().Find(Problem::kOddReadings, channel.config.channel(), std::move(text));
}

void Mapper::NoticeQueueDrops() {
  const ScanQueueCounts& counts = queue_.counts();
  for (int k = 0; k < kNumDropReasons; ++k) {
    const auto reason = static_cast<DropReason>(k);
    if (reason == DropReason::kScanWithoutPose) continue;  // a few are usual; see below
    if (counts.drops[reason] > noticed_.drops[reason]) {
      Settled().notices.Add(
          true, DropName(reason),
          fmt::format("dropped {}: {}", DropName(reason), DropExplanation(reason)));
    }
  }
  for (size_t k = 0; k < scan_channels_.size(); ++k) {
    NoticeMissingPoses(static_cast<int>(k));
  }
  if (counts.time_jumps > noticed_.time_jumps) {
    Settled().Find(Problem::kTimeJump,
                   counts.jumped_channel ? scan_channels_[*counts.jumped_channel].config.channel()
                                         : pose_channel_,
                   "message time jumped back (a log was rewound?); the map is kept");
  }
  if (counts.pose_jumps > noticed_.pose_jumps) NoticePoseJump();
  noticed_ = counts;
}

void Mapper::NoticePoseJump() {
  const auto& [from, to] = *queue_.counts().last_pose_jump;
  Settled().Find(Problem::kPoseJump, pose_channel_,
                 PoseJumps(from, to, queue_.counts().pose_jumps));
}

void Mapper::NoticeMissingPoses(int index) {
  ScanChannel& channel = scan_channels_[index];
  const int64_t in_a_row = queue_.counts().without_pose_in_a_row[index];
  const std::string& name = channel.config.channel();
  if (in_a_row == 0 && std::exchange(channel.has_no_poses, false)) {
    Settled().notices.Add(false, "poses again " + name, name + ": scans have poses again");
  }
  if (in_a_row / kManyScans <= noticed_.without_pose_in_a_row[index] / kManyScans) return;
  channel.has_no_poses = true;
  Settled().Find(Problem::kWithoutPoses, name,
                 fmt::format("{} scans in a row have no poses before and after them. {}", in_a_row,
                             WhyWithoutPoses(index)));
}

std::string Mapper::WhyWithoutPoses(int index) const {
  const ScanChannel& channel = scan_channels_[index];
  if (!newest_pose_utime_) return fmt::format("No pose came on {}", pose_channel_);
  const int64_t ahead_ms = (*channel.newest_utime - *newest_pose_utime_).count() / 1000;
  if (std::abs(ahead_ms) < kOtherClock_ms) {
    return fmt::format("Do poses come regularly on {}?", pose_channel_);
  }
  const double ratio = static_cast<double>(newest_pose_utime_->count()) /
                       static_cast<double>(std::max<int64_t>(channel.newest_utime->count(), 1));
  for (const auto& [unit, per_second] :
       {std::pair("milliseconds", 1e3), std::pair("seconds", 1.0)}) {
    if (std::abs(ratio * per_second / 1e6 - 1) > 0.01) continue;
    return fmt::format(
        "Its stamps seem to be {}, and messages have microseconds: mend the sender, or use the "
        "time "
        "of reception, --scan {}:stamp=receive",
        unit, channel.config.channel());
  }
  const int64_t mending_ms = channel.options->time_offset.count() / 1000 - ahead_ms;
  return fmt::format(
      "They are stamped {:.1f} s {} the poses of {}. Has {} stopped, or is it another clock? If it "
      "is, and always as far off: time_offset_ms={}",
      std::abs(static_cast<double>(ahead_ms)) / 1000, ahead_ms > 0 ? "after" : "before",
      pose_channel_, pose_channel_, std::abs(mending_ms) < 100 ? 0 : mending_ms);
}

MapperCounts Mapper::counts() const {
  MapperCounts counts = counts_;
  counts.scans_mapped = builder_.scans_mapped();
  counts.beams_mapped = builder_.beams_mapped();
  counts.drops = findings_.drops;
  counts.drops += queue_.counts().drops;
  counts.problems = findings_.problems;
  return counts;
}

}  // namespace splinemap
