#include "lib/pipeline/layer_builder.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "lib/base/status.h"
#include "lib/diagnosis/map_match.h"

namespace splinemap {
namespace {

// So many scans in a row at odds with the map are no accident: a walker, an opened door.
constexpr int kDisagreeingScans = 12;
// A scan is at odds with the map where this share of its hits lies in free space: of a room that is
// taken to be elsewhere, half of the walls do, and half lie beyond. Of recorded drives a few
// percent.
constexpr double kAtOdds = 0.35;
constexpr int kMinHits = 10;
// A robot that hardly moves in so many scans gives nothing to try flags on.
constexpr int kScansBeforeFlags = 300;
// Scans are compared with the map as it was up to so many scans ago: soon they have overwritten
// what they contradict.
constexpr int kScansSinceEarlier = 100;

}  // namespace

LayerBuilder::LayerBuilder(const config::Config& config, MapOptions map_options, Layer& layer,
                           ScanArchive archive, Findings& findings)
    : pose_channel_(config.pose()),
      map_options_(map_options),
      layer_(layer),
      earlier_tiles_(layer.Snapshot().tiles),
      is_continued_(layer.tiles().size() > 0),
      max_tiles_((size_t{config.service().max_map_mb()} << 20) / sizeof(Tile)),
      max_archive_bytes_(size_t{config.service().max_archive_mb()} << 20),
      archive_(std::move(archive)),
      beam_model_(BeamModelOptionsOf(config.method())),
      preparing_(map_options),
      folder_(map_options),
      findings_(findings) {
  if (max_archive_bytes_ == 0) KeepNoScans();
  for (const config::Scan& scan : config.scan()) channels_.emplace_back().name = scan.channel();
}

bool LayerBuilder::Item::is_filtered() const { return min_travel_m > 0 || min_turn_rad > 0; }

void LayerBuilder::Prepare(Item& item) {
  Place(item.scan, archive_.map_T_world, item.placed);
  item.is_placed = true;
  // Lines are most of the work, which robots that stand still are to be spared.
  if (!item.is_filtered()) MakeLines(preparing_, item);
}

void LayerBuilder::MakeLines(ScanFolder& folder, Item& item) const {
  item.has_lines = true;
  item.can_be = folder.Check(item.placed);
  if (!item.can_be.ok()) return;
  folder.Prepare(item.placed, beam_model_, item.lines);
  if (max_archive_bytes_ > 0) item.packed = Pack(item.scan, beam_model_);
}

void LayerBuilder::Map(Item& item) {
  const PlacedScan& placed = item.placed;
  Channel& channel = channels_[item.scan.channel];
  if (!why_refused_.empty() || layer_.tiles().size() >= max_tiles_) {
    findings_.Drop(DropReason::kMapFull, channel.name,
                   why_refused_.empty() ? DropExplanation(DropReason::kMapFull) : why_refused_);
    return;
  }
  if (!item.is_placed) Place(item.scan, archive_.map_T_world, item.placed);
  if (!HasMoved(channel, item)) {
    ++findings_.drops[DropReason::kStoodStill];  // as configured: nothing to say
    return;
  }
  if (!item.has_lines) MakeLines(folder_, item);
  if (!item.can_be.ok()) {
    findings_.Drop(DropReason::kPoseOutOfRange, channel.name, ErrorText(item.can_be));
    return;
  }
  if (max_archive_bytes_ > 0) Keep(std::move(item.packed));
  CheckAgainstMap(channel, placed);
  folder_.FoldPrepared(placed, beam_model_, item.lines, layer_);
  ++scans_mapped_;
  beams_mapped_ += std::ssize(placed.beams);
  newest_scan_utime_ = placed.utime;
  channel.last_map_T_robot = placed.map_T_robot;
  if (max_archive_bytes_ > 0) return;
  ++archive_.base.scans;
  archive_.base.newest = std::max(archive_.base.newest, placed.utime);
}

// Whoever follows is told first, and maps it at the same time.
void LayerBuilder::Keep(PackedScan scan) {
  if (on_scan_) on_scan_(layer_.revision() + 1, scan);
  archive_.Add(std::move(scan), beam_model_);
  Shorten(archive_, max_archive_bytes_, map_options_);
}

// One byte: that scans are kept at all is told to followers, and stays.
void LayerBuilder::LimitArchive(size_t max_bytes) {
  if (max_archive_bytes_ == 0) return;
  max_archive_bytes_ = std::max<size_t>(1, std::min(max_archive_bytes_, max_bytes));
  Shorten(archive_, max_archive_bytes_, map_options_);
}

// What was kept is in the layer for good.
void LayerBuilder::KeepNoScans() {
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

void LayerBuilder::ReplaceArchive(ScanArchive archive) {
  archive_ = std::move(archive);
  earlier_tiles_ = layer_.Snapshot().tiles;
  scans_since_earlier_ = 0;
}

LayerSnapshot LayerBuilder::Snapshot() {
  LayerSnapshot layer = layer_.Snapshot();
  if (max_archive_bytes_ == 0) archive_.base.tiles = layer.tiles;
  layer.archive = std::make_shared<ScanArchive>(archive_);
  return layer;
}

bool LayerBuilder::HasMoved(const Channel& channel, const Item& item) {
  if (!item.is_filtered() || !channel.last_map_T_robot) return true;
  const Pose2& last = *channel.last_map_T_robot;
  const Pose2& map_T_robot = item.placed.map_T_robot;
  const double travel_m = (map_T_robot.position_m - last.position_m).norm();
  const double turn_rad = std::abs(WrapAngle(map_T_robot.yaw_rad - last.yaw_rad));
  return (item.min_travel_m > 0 && travel_m >= item.min_travel_m) ||
         (item.min_turn_rad > 0 && turn_rad >= item.min_turn_rad);
}

void LayerBuilder::CheckAgainstMap(Channel& channel, const PlacedScan& scan) {
  if (++scans_since_earlier_ >= kScansSinceEarlier && channel.disagreeing_in_a_row == 0) {
    earlier_tiles_ = layer_.Snapshot().tiles;
    scans_since_earlier_ = 0;
    is_continued_ = false;
  }
  // First things first: wrong flags make scans disagree, too.
  if (!is_continued_ && !channel.are_flags_tried &&
      ++channel.scans_before_flags < kScansBeforeFlags)
    return;
  const HitsInMap hits = FindHits(scan, earlier_tiles_, map_options_.knot_interval_m);
  if (hits.looked_up < kMinHits) return;
  const bool at_odds = hits.in_free > kAtOdds * hits.looked_up;
  channel.disagreeing_in_a_row = at_odds ? channel.disagreeing_in_a_row + 1 : 0;
  if (channel.disagreeing_in_a_row != kDisagreeingScans) return;
  channel.disagreeing_in_a_row = 0;
  if (!channel.better_options.empty()) {
    findings_.Find(Problem::kOptionsDisagree, channel.name, channel.better_options);
    return;
  }
  findings_.Find(
      Problem::kMapDisagrees, channel.name,
      fmt::format("{} scans in a row do not match the map: many of their hits lie where it is "
                  "free. Did the localisation on {} jump, or does it drift, or is it in another "
                  "frame or clock than when the map was made? splinemap doctor compares the pose "
                  "channels of a log",
                  kDisagreeingScans, pose_channel_));
}

void LayerBuilder::SetFlagsTried(int channel, std::string better_options) {
  channels_[channel].are_flags_tried = true;
  channels_[channel].better_options = std::move(better_options);
}

}  // namespace splinemap
