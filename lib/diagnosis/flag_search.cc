#include "lib/diagnosis/flag_search.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "lib/base/status.h"
#include "lib/diagnosis/hit_spread.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr size_t kMinScans = 10;
constexpr double kMinTurn_rad = 30 * std::numbers::pi / 180;

// Two scans of a sample are at least one of these apart.
constexpr double kNewPlace_m = 0.1;
constexpr double kNewPlace_rad = 3 * std::numbers::pi / 180;

constexpr Utime kMaxTriedOffset = seconds(1);
// Poses that a scan needs around it: offsets, durations and refinement stay within.
constexpr Utime kMargin = kMaxTriedOffset + milliseconds(500);
constexpr Utime kMaxPoseGap = seconds(1);
constexpr size_t kMaxWaiting = 1000;

constexpr double kClearlySharper = 0.8;
constexpr double kSharper = 0.95;

// A reading kept in `count` beams, evenly.
RangeReadings Thinned(RangeReadings readings, size_t max_beams) {
  const size_t step = (readings.ranges_m.size() + max_beams - 1) / max_beams;
  if (step <= 1) return readings;
  RangeReadings thin;
  thin.utime = readings.utime;
  for (size_t k = 0; k < readings.ranges_m.size(); k += step) {
    thin.ranges_m.push_back(readings.ranges_m[k]);
    thin.bearings_rad.push_back(readings.bearings_rad[k]);
    if (!readings.beam_utimes.empty()) thin.beam_utimes.push_back(readings.beam_utimes[k]);
  }
  return thin;
}

bool HasBeamTimes(const DriveSample& sample) {
  return std::all_of(sample.scans().begin(), sample.scans().end(), &HaveUsefulBeamTimes);
}

// Appends the hits of a scan. Poses between those of the first and the last beam are interpolated
// between these two, which is near enough to compare flags.
void PlaceHits(const Scan& scan, const PoseBuffer& poses, std::vector<Eigen::Vector2d>& hits) {
  const Utime first = scan.utime + scan.first_beam;
  const Utime last = scan.utime + scan.last_beam;
  const auto at_first = poses.Find(first);
  const auto at_last = poses.Find(last);
  if (!at_first || !at_last) return;
  const Pose2 from = Interpolate(*at_first, first);
  const Pose2 to = Interpolate(*at_last, last);
  const double span = std::max(1.0, static_cast<double>((last - first).count()));
  for (const Beam& beam : scan.beams) {
    if (!beam.hit) continue;
    const auto passed = static_cast<double>((beam.time_offset - scan.first_beam).count());
    const Pose2 world_T_sensor = Interpolate(from, to, passed / span) * scan.robot_T_sensor;
    const double bearing_rad = world_T_sensor.yaw_rad + double{beam.bearing_rad};
    hits.push_back(world_T_sensor.position_m +
                   double{beam.range_m} *
                       Eigen::Vector2d(std::cos(bearing_rad), std::sin(bearing_rad)));
  }
}

// The sharpest of some options so far.
class Best {
 public:
  Best(const DriveSample& sample, const SensorOptions& options)
      : sample_(sample), options_(options), spread_(SpreadOf(sample, options)) {}

  // Keeps `options` where they are sharper than what it has by `factor`.
  void Try(const SensorOptions& options) {
    if (const double spread = SpreadOf(sample_, options); spread < spread_) {
      options_ = options;
      spread_ = spread;
    }
  }
  const SensorOptions& options() const { return options_; }
  double spread() const { return spread_; }

 private:
  const DriveSample& sample_;
  SensorOptions options_;
  double spread_;
};

void TryOffsets(Best& best, SensorOptions options, Utime around, Utime reach, Utime step) {
  for (Utime offset = around - reach; offset <= around + reach; offset += step) {
    options.time_offset = offset;
    best.Try(options);
  }
}

// Sign of bearing and quarter turns of the sensor, whatever the time offset.
SensorOptions WithBestDirections(const DriveSample& sample, const SensorOptions& given) {
  constexpr Utime kReach = milliseconds(400);
  constexpr Utime kStep = milliseconds(200);
  Best as_given(sample, given);
  TryOffsets(as_given, given, given.time_offset, kReach, kStep);
  Best other = as_given;
  for (const int sign : {1, -1}) {
    for (int quarters = 0; quarters < 4; ++quarters) {
      SensorOptions options = given;
      options.bearing_sign = sign;
      options.mount.robot_T_sensor.yaw_rad += quarters * std::numbers::pi / 2;
      TryOffsets(other, options, given.time_offset, kReach, kStep);
    }
  }
  SensorOptions found = given;
  if (other.spread() < kClearlySharper * as_given.spread()) {
    found.bearing_sign = other.options().bearing_sign;
    found.mount = other.options().mount;
  }
  return found;
}

SensorOptions WithBestTimes(const DriveSample& sample, const SensorOptions& given) {
  Best best(sample, given);
  const double spread_given = best.spread();
  std::vector<SensorOptions> ways{given};
  for (const int duration_ms : {0, 100, 200, -100, -200}) {
    SensorOptions options = given;
    options.use_beam_times = false;
    options.scan_duration = milliseconds(duration_ms);
    ways.push_back(options);
  }
  if (HasBeamTimes(sample)) {
    ways.push_back(given);
    ways.back().use_beam_times = true;
  }
  for (const SensorOptions& way : ways) {
    TryOffsets(best, way, given.time_offset, kMaxTriedOffset, milliseconds(100));
  }
  TryOffsets(best, best.options(), best.options().time_offset, milliseconds(75), milliseconds(25));
  return best.spread() < kSharper * spread_given ? best.options() : given;
}

double Milliseconds(Utime time) { return static_cast<double>(time.count()) / 1000; }

// What has to be said beside a preset.
std::vector<std::string> OptionsBeside(const SensorOptions& preset, const SensorOptions& wanted) {
  std::vector<std::string> options;
  if (wanted.bearing_sign != preset.bearing_sign) {
    options.push_back(fmt::format("bearing_sign={}", wanted.bearing_sign));
  }
  if (wanted.time_offset != preset.time_offset) {
    options.push_back(fmt::format("time_offset_ms={}", Milliseconds(wanted.time_offset)));
  }
  if (wanted.use_beam_times != preset.use_beam_times) {
    options.push_back(fmt::format("beam_times={}", wanted.use_beam_times));
  }
  if (!wanted.use_beam_times && wanted.scan_duration != preset.scan_duration) {
    options.push_back(fmt::format("scan_duration_ms={}", Milliseconds(wanted.scan_duration)));
  }
  const double yaw_deg = WrapAngle(wanted.mount.robot_T_sensor.yaw_rad) * 180 / std::numbers::pi;
  if (std::abs(yaw_deg) > 1e-9) options.push_back(fmt::format("yaw_deg={:.6g}", yaw_deg));
  return options;
}

}  // namespace

DriveSample::DriveSample(size_t max_scans, size_t max_beams)
    : max_scans_(max_scans), max_beams_(max_beams), poses_(std::chrono::hours(24)) {}

void DriveSample::AddPose(const TimedPose& pose) {
  if (full()) return;
  poses_.Add(pose);
  KeepScans();
}

void DriveSample::AddScan(RangeReadings readings, Utime time_offset) {
  if (full()) return;
  waiting_.emplace_back(Thinned(std::move(readings), max_beams_), time_offset);
  if (waiting_.size() > kMaxWaiting) waiting_.pop_front();
  KeepScans();
}

void DriveSample::KeepScans() {
  while (!waiting_.empty() && !full() && !poses_.empty()) {
    auto& [readings, time_offset] = waiting_.front();
    const Utime utime = readings.utime + time_offset;
    if (poses_.newest() < utime + kMargin) return;
    const auto bracket = poses_.Find(utime);
    if (poses_.oldest() <= utime - kMargin && bracket &&
        bracket->after->utime - bracket->before->utime <= kMaxPoseGap &&
        IsNewPlace(Interpolate(*bracket, utime))) {
      scans_.push_back(std::move(readings));
    }
    waiting_.pop_front();
  }
}

bool DriveSample::IsNewPlace(const Pose2& world_T_robot) {
  if (last_place_) {
    const double moved_m = (world_T_robot.position_m - last_place_->position_m).norm();
    const double turned_rad = std::abs(WrapAngle(world_T_robot.yaw_rad - last_place_->yaw_rad));
    if (moved_m < kNewPlace_m && turned_rad < kNewPlace_rad) return false;
    turned_rad_ += turned_rad;
  }
  last_place_ = world_T_robot;
  return true;
}

double SpreadOf(const DriveSample& sample, const SensorOptions& options) {
  std::vector<Eigen::Vector2d> hits;
  for (const RangeReadings& readings : sample.scans()) {
    if (const auto scan = PrepareScan(readings, options, 0); scan.ok()) {
      PlaceHits(*scan, sample.poses(), hits);
    }
  }
  return HitSpread(hits);
}

std::optional<FlagProposal> SearchFlags(const DriveSample& sample, const SensorOptions& given) {
  if (sample.scans().size() < kMinScans || sample.turned_rad() < kMinTurn_rad) return std::nullopt;
  FlagProposal proposal;
  proposal.options = WithBestTimes(sample, WithBestDirections(sample, given));
  proposal.spread = SpreadOf(sample, proposal.options);
  proposal.spread_given = SpreadOf(sample, given);
  SensorOptions flipped = proposal.options;
  flipped.bearing_sign = -flipped.bearing_sign;
  proposal.spread_flipped = SpreadOf(sample, flipped);
  return proposal;
}

std::string ScanFlag(const std::string& channel, const std::string& preset,
                     const SensorOptions& options) {
  std::vector<std::string> presets = PresetNames();
  std::stable_partition(presets.begin(), presets.end(),
                        [&](const std::string& name) { return name == preset; });
  std::string shortest;
  size_t fewest = SIZE_MAX;
  for (const std::string& name : presets) {
    const auto beside = OptionsBeside(SensorOptionsOf(config::Scan(), name), options);
    if (beside.size() >= fewest) continue;
    fewest = beside.size();
    shortest = fmt::format("{}:{}", channel, name);
    for (const std::string& option : beside) shortest += "," + option;
  }
  return shortest;
}

}  // namespace splinemap
