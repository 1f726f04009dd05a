#include "lib/pipeline/mapper.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "lib/base/status.h"
#include "lib/diagnosis/map_match.h"
#include "lib/diagnosis/pose_oddities.h"
#include "lib/wire/sensor_messages.h"

namespace splinemap {
namespace {

// So many scans in a row without pose are a problem and no beginning or end.
constexpr int kManyScans = 20;
// So many scans in a row at odds with the map are no accident: a walker, an opened door.
constexpr int kDisagreeingScans = 12;
// A scan is at odds with the map where this share of its hits lies in free space: of a room that is
// taken to be elsewhere, half of the walls do, and half lie beyond. Of recorded drives a few
// percent.
constexpr double kAtOdds = 0.35;
constexpr int kMinHits = 10;

// What the flags are tried on, once in the first seconds. A tenth of a second of work.
constexpr size_t kDriveScans = 40;
constexpr size_t kDriveBeams = 90;
// A robot that hardly moves in so many scans gives nothing to try them on.
constexpr int kScansBeforeFlags = 300;
// Scans are compared with the map as it was up to so many scans ago: soon they have overwritten
// what they contradict.
constexpr int kScansSinceEarlier = 100;
// Time stamps so far apart are not those of one clock.
constexpr int64_t kOtherClock_ms = 1000;

}  // namespace

Mapper::Mapper(const config::Config& config, MapOptions map_options, Layer& layer,
               ScanArchive archive)
    : pose_channel_(config.pose()),
      max_coordinate_m_(ScanFolder::MaxCoordinate_m(map_options)),
      map_options_(map_options),
      layer_(layer),
      earlier_tiles_(layer.Snapshot().tiles),
      is_continued_(layer.tiles().size() > 0),
      max_tiles_((size_t{config.service().max_map_mb()} << 20) / sizeof(Tile)),
      max_archive_bytes_(size_t{config.service().max_archive_mb()} << 20),
      archive_(std::move(archive)),
      beam_model_(BeamModelOptionsOf(config.method())),
      folder_(map_options),
      queue_(ScanQueueOptionsOf(config.timing()), config.scan_size()),
      noticed_(queue_.counts()) {
  if (max_archive_bytes_ == 0) KeepNoScans();
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
  // A short drive is better than none.
  for (ScanChannel& channel : scan_channels_) {
    if (channel.drive && channel.options) TryOtherFlags(channel);
  }
}

void Mapper::HandleScan(int channel, absl::Span<const uint8_t> message, Utime received) {
  ++counts_.scans_received;
  ScanChannel& scan_channel = scan_channels_[channel];
  const std::string& name = scan_channel.config.channel();
  const std::optional<MessageType> type = TypeOf(message);
  absl::StatusOr<RangeReadings> readings = DecodeScan(message);
  if (!readings.ok()) {
    Drop(type && IsScan(*type) ? DropReason::kMalformedScan : DropReason::kWrongTypeOfScan, name,
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
      Drop(DropReason::kNoExtrinsics, name, DropExplanation(DropReason::kNoExtrinsics));
      return;
    }
    options.mount = *scan_channel.mount;
  }
  absl::StatusOr<Scan> scan = PrepareScan(*readings, options, channel);
  if (!scan.ok()) {
    Drop(DropReason::kUnusableScan, name, ErrorText(scan.status()));
    return;
  }
  if (options.use_beam_times && readings->beam_utimes.size() > 1 &&
      !HaveUsefulBeamTimes(*readings)) {
    Find(Problem::kUselessBeamTimes, name,
         "the beam times of its scans differ by less than 10 ms; if the sensor is slower, set "
         "beam_times=false and scan_duration_ms, as preset michigan_2017 does");
  }
  if (scan_channel.drive) {
    scan_channel.drive->AddScan(*std::move(readings), options.time_offset);
    TryFlagsOnceFull(scan_channel);
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
      Drop(DropReason::kUnusableScan, name, "has too few beams to tell its preset");
      return false;
    }
    notices_.Add(false, fmt::format("preset {} {}", name, preset),
                 fmt::format("{}: {} is read with preset {}, told from the first message", name,
                             TypeName(type), preset));
  }
  channel.type = type;
  channel.preset = preset;
  channel.options = SensorOptionsOf(channel.config, preset);
  return true;
}

void Mapper::HandleExtrinsics(ScanChannel& channel, absl::Span<const uint8_t> message) {
  const absl::StatusOr<SensorMount> mount = DecodeSensorMount(message);
  if (!mount.ok()) {
    Drop(DropReason::kMalformedExtrinsics, channel.config.extrinsics_channel(),
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
    Drop(type && IsPose(*type) ? DropReason::kMalformedPose : DropReason::kWrongTypeOfPose,
         pose_channel_, ErrorText(pose.status()));
    return;
  }
  if (const Eigen::Vector2d& p = pose->world_T_robot.position_m;
      p.cwiseAbs().maxCoeff() > max_coordinate_m_) {
    Drop(DropReason::kPoseOutOfRange, pose_channel_,
         fmt::format("pose at ({}, {}) m; {:.0f} m is the most", p.x(), p.y(), max_coordinate_m_));
    return;
  }
  if (pose->resolution_m > kCoarsePose_m && !std::exchange(poses_are_coarse_, true)) {
    Find(Problem::kCoarsePoses, pose_channel_, CoarsePoses(*pose));
  }
  newest_pose_utime_ = pose->utime;
  queue_.AddPose(*pose);
  for (ScanChannel& channel : scan_channels_) {
    if (!channel.drive) continue;
    channel.drive->AddPose(*pose);
    TryFlagsOnceFull(channel);
  }
  MapReadyScans();
}

void Mapper::MapReadyScans() {
  while (std::optional<PosedScan> scan = queue_.Next()) MapScan(*std::move(scan));
  NoticeQueueDrops();
}

void Mapper::MapScan(PosedScan scan) {
  ScanChannel& channel = scan_channels_[scan.channel];
  const std::string& name = channel.config.channel();
  if (!why_refused_.empty() || layer_.tiles().size() >= max_tiles_) {
    Drop(DropReason::kMapFull, name,
         why_refused_.empty() ? DropExplanation(DropReason::kMapFull) : why_refused_);
    return;
  }
  Place(scan, archive_.map_T_world, placed_);
  if (!HasMoved(channel, placed_.map_T_robot)) {
    ++counts_.drops[DropReason::kStoodStill];  // as configured: nothing to say
    return;
  }
  if (const absl::Status can_be = folder_.Check(placed_); !can_be.ok()) {
    Drop(DropReason::kPoseOutOfRange, name, ErrorText(can_be));
    return;
  }
  if (max_archive_bytes_ > 0) Keep(Pack(scan, beam_model_));
  CheckAgainstMap(channel, placed_);
  folder_.Fold(placed_, beam_model_, layer_);
  ++counts_.scans_mapped;
  counts_.beams_mapped += static_cast<int64_t>(scan.beams.size());
  newest_scan_utime_ = scan.utime;
  channel.last_map_T_robot = placed_.map_T_robot;
  if (max_archive_bytes_ > 0) return;
  ++archive_.base.scans;
  archive_.base.newest = std::max(archive_.base.newest, scan.utime);
}

// Whoever follows is told first, and maps it at the same time.
void Mapper::Keep(PackedScan scan) {
  if (on_scan_) on_scan_(layer_.revision() + 1, scan);
  archive_.Add(std::move(scan), beam_model_);
  Shorten(archive_, max_archive_bytes_, map_options_);
}

// One byte: that scans are kept at all is told to followers, and stays.
void Mapper::LimitArchive(size_t max_bytes) {
  if (max_archive_bytes_ == 0) return;
  max_archive_bytes_ = std::max<size_t>(1, std::min(max_archive_bytes_, max_bytes));
  Shorten(archive_, max_archive_bytes_, map_options_);
}

// What was kept is in the layer for good.
void Mapper::KeepNoScans() {
  ScanArchive::Base& base = archive_.base;
  archive_.ForEachPose([&](const ScanPose& pose) {
    ++base.scans;
    base.newest = std::max(base.newest, pose.utime);
  });
  ScanArchive none;
  none.map_T_world = archive_.map_T_world;
  none.base = {layer_.Snapshot().tiles, archive_.map_T_world, base.scans, base.newest};
  archive_ = std::move(none);
}

void Mapper::ReplaceArchive(ScanArchive archive) {
  archive_ = std::move(archive);
  earlier_tiles_ = layer_.Snapshot().tiles;
  scans_since_earlier_ = 0;
}

LayerSnapshot Mapper::Snapshot() {
  LayerSnapshot layer = layer_.Snapshot();
  if (max_archive_bytes_ == 0) archive_.base.tiles = layer.tiles;
  layer.archive = std::make_shared<ScanArchive>(archive_);
  return layer;
}

bool Mapper::HasMoved(const ScanChannel& channel, const Pose2& map_T_robot) const {
  const SensorOptions& options = *channel.options;
  const bool is_filtered = options.min_travel_m > 0 || options.min_turn_rad > 0;
  if (!is_filtered || !channel.last_map_T_robot) return true;
  const Pose2& last = *channel.last_map_T_robot;
  const double travel_m = (map_T_robot.position_m - last.position_m).norm();
  const double turn_rad = std::abs(WrapAngle(map_T_robot.yaw_rad - last.yaw_rad));
  return (options.min_travel_m > 0 && travel_m >= options.min_travel_m) ||
         (options.min_turn_rad > 0 && turn_rad >= options.min_turn_rad);
}

void Mapper::CheckAgainstMap(ScanChannel& channel, const PlacedScan& scan) {
  if (++scans_since_earlier_ >= kScansSinceEarlier && channel.disagreeing_in_a_row == 0) {
    earlier_tiles_ = layer_.Snapshot().tiles;
    scans_since_earlier_ = 0;
    is_continued_ = false;
  }
  // First things first: wrong flags make scans disagree, too.
  if (!is_continued_ && channel.drive && ++channel.scans_before_flags < kScansBeforeFlags) return;
  const HitsInMap hits = FindHits(scan, earlier_tiles_, map_options_.knot_interval_m);
  if (hits.looked_up < kMinHits) return;
  const bool at_odds = hits.in_free > kAtOdds * hits.looked_up;
  channel.disagreeing_in_a_row = at_odds ? channel.disagreeing_in_a_row + 1 : 0;
  if (channel.disagreeing_in_a_row != kDisagreeingScans) return;
  channel.disagreeing_in_a_row = 0;
  if (!channel.better_options.empty()) {
    Find(Problem::kOptionsDisagree, channel.config.channel(), channel.better_options);
    return;
  }
  Find(Problem::kMapDisagrees, channel.config.channel(),
       fmt::format("{} scans in a row do not match the map: many of their hits lie where it is "
                   "free. Did the localisation on {} jump, or does it drift, or is it in another "
                   "frame or clock than when the map was made? splinemap doctor compares the pose "
                   "channels of a log",
                   kDisagreeingScans, pose_channel_));
}

void Mapper::TryFlagsOnceFull(ScanChannel& channel) {
  if (channel.drive->full()) TryOtherFlags(channel);
}

void Mapper::TryOtherFlags(ScanChannel& channel) {
  const std::unique_ptr<DriveCollector> drive = std::move(channel.drive);
  const auto proposal = SearchFlags(drive->sample(), *channel.options);
  if (!proposal || proposal->spread > kClearlySharper * proposal->spread_given) return;
  const std::string flag = ScanFlagOf(ScanWith(channel.config, channel.preset, proposal->options));
  channel.better_options =
      proposal->is_time_beyond
          ? fmt::format(
                "its scans and the poses of {} seem to be more than a second apart; set or "
                "correct time_offset_ms",
                pose_channel_)
          : fmt::format(
                "read otherwise it gives a sharper map: hits lie in {:.0f} cells of 5 cm, "
                "and in {:.0f} as it is read now. Try --scan {}",
                proposal->spread, proposal->spread_given, flag);
  Find(Problem::kOptionsDisagree, channel.config.channel(), channel.better_options);
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
  Find(Problem::kOddReadings, channel.config.channel(), std::move(text));
}

void Mapper::Drop(DropReason reason, const std::string& channel, const std::string& explanation) {
  ++counts_.drops[reason];
  notices_.Add(true, fmt::format("{} {}", DropName(reason), channel),
               fmt::format("dropped {} on {}: {}", DropName(reason), channel, explanation));
}

void Mapper::Find(Problem problem, const std::string& channel, std::string text) {
  ++counts_.problems[static_cast<int>(problem)];
  notices_.Add(true, fmt::format("{} {}", ProblemName(problem), channel),
               fmt::format("{}: {}", channel, text));
}

void Mapper::NoticeQueueDrops() {
  const ScanQueueCounts& counts = queue_.counts();
  for (int k = 0; k < kNumDropReasons; ++k) {
    const auto reason = static_cast<DropReason>(k);
    if (reason == DropReason::kScanWithoutPose) continue;  // a few are usual; see below
    if (counts.drops[reason] > noticed_.drops[reason]) {
      notices_.Add(true, DropName(reason),
                   fmt::format("dropped {}: {}", DropName(reason), DropExplanation(reason)));
    }
  }
  for (size_t k = 0; k < scan_channels_.size(); ++k) {
    NoticeMissingPoses(static_cast<int>(k));
  }
  if (counts.time_jumps > noticed_.time_jumps) {
    Find(Problem::kTimeJump,
         counts.jumped_channel ? scan_channels_[*counts.jumped_channel].config.channel()
                               : pose_channel_,
         "message time jumped back (a log was rewound?); the map is kept");
  }
  if (counts.pose_jumps > noticed_.pose_jumps) NoticePoseJump();
  noticed_ = counts;
}

void Mapper::NoticePoseJump() {
  const auto& [from, to] = *queue_.counts().last_pose_jump;
  Find(Problem::kPoseJump, pose_channel_, PoseJumps(from, to, queue_.counts().pose_jumps));
}

void Mapper::NoticeMissingPoses(int index) {
  ScanChannel& channel = scan_channels_[index];
  const int64_t in_a_row = queue_.counts().without_pose_in_a_row[index];
  const std::string& name = channel.config.channel();
  if (in_a_row == 0 && std::exchange(channel.has_no_poses, false)) {
    notices_.Add(false, "poses again " + name, name + ": scans have poses again");
  }
  if (in_a_row / kManyScans <= noticed_.without_pose_in_a_row[index] / kManyScans) return;
  channel.has_no_poses = true;
  Find(Problem::kWithoutPoses, name,
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
  counts.drops += queue_.counts().drops;
  return counts;
}

}  // namespace splinemap
