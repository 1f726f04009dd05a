#include "lib/diagnosis/sensor_option_search.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "lib/config/checked_text.h"
#include "lib/diagnosis/hit_entropy.h"
#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr double kMinTurn_rad = 30 * std::numbers::pi / 180;

constexpr Utime kMaxTriedOffset = seconds(1);
// So near to it, the best of the tried offsets is the edge and no optimum.
constexpr Utime kEdge = milliseconds(150);

bool HasBeamTimes(const RecordingSample& sample) {
  return std::all_of(sample.scans.begin(), sample.scans.end(), &HaveUsefulBeamTimes);
}

// Appends the hits of a scan. Poses between those of the first and the last beam are interpolated
// between these two, which is near enough to compare flags.
void PlaceHits(const Scan& scan, const PoseBuffer& poses, std::vector<Eigen::Vector2d>& hits) {
  const Utime first = scan.utime + scan.first_beam;
  const Utime last = scan.utime + scan.last_beam;
  const auto at_first = poses.Find(first);
  const auto at_last = poses.Find(last);
  if (!at_first || !at_last || poses.IsInJump(first) || poses.IsInJump(last)) return;
  const Eigen::Vector3d up_robot = InterpolateUp(*at_first, first);
  if (IsTiltedTooMuch(up_robot)) return;
  const Pose2 from = Interpolate(*at_first, first);
  const Pose2 to = Interpolate(*at_last, last);
  const double span = std::max(1.0, static_cast<double>((last - first).count()));
  std::vector<Pose2> world_T_sensor;
  world_T_sensor.reserve(scan.beams.size());
  for (const Beam& beam : scan.beams) {
    const auto passed = static_cast<double>((beam.time_offset - scan.first_beam).count());
    world_T_sensor.push_back(Interpolate(from, to, passed / span) * scan.robot_T_sensor);
  }
  std::vector<PlacedBeam> placed;
  Place(scan.beams, world_T_sensor, placed);
  Tilt(scan.beams, scan.robot_T_sensor.yaw_rad, up_robot, placed);
  for (const PlacedBeam& beam : placed) {
    if (beam.hit) hits.push_back(beam.origin_world_m + beam.range_m * beam.direction_world);
  }
}

// The sharpest of some options so far.
class Best {
 public:
  Best(const RecordingSample& sample, const SensorOptions& options)
      : sample_(sample), options_(options), spread_(SpreadOf(sample, options)) {}

  // Keeps `options` where they are sharper than what it has. Hits that are not placed do not make a
  // map sharp.
  void Try(const SensorOptions& options) {
    const SampleSpread spread = SpreadOf(sample_, options);
    if (spread.hits >= spread_.hits && spread.cells < spread_.cells) {
      options_ = options;
      spread_ = spread;
    }
  }
  const SensorOptions& options() const { return options_; }
  double cells() const { return spread_.cells; }

 private:
  const RecordingSample& sample_;
  SensorOptions options_;
  SampleSpread spread_;
};

void TryOffsets(Best& best, SensorOptions options, Utime around, Utime reach, Utime step) {
  for (Utime offset = around - reach; offset <= around + reach; offset += step) {
    options.time_offset = offset;
    best.Try(options);
  }
}

// Wider ones than the messages say, which have it wrong where the format does not tell it. Narrower
// ones make any map smaller.
std::vector<double> FieldsOfView(const RecordingSample& sample, const SensorOptions& given) {
  std::vector<double> fields{given.field_of_view_rad};
  const double told_rad = given.field_of_view_rad > 0
                              ? given.field_of_view_rad
                              : FieldOfView(sample.scans.front().bearings_rad);
  for (const double degrees : {240, 270, 360}) {
    const double wider_rad = degrees * std::numbers::pi / 180;
    if (told_rad > 0 && wider_rad > 1.1 * told_rad) fields.push_back(wider_rad);
  }
  return fields;
}

// Field of view, sign of bearing and quarter turns of the sensor, whatever the time offset.
SensorOptions WithBestDirections(const RecordingSample& sample, const SensorOptions& given) {
  constexpr Utime kReach = milliseconds(400);
  constexpr Utime kStep = milliseconds(200);
  Best as_given(sample, given);
  TryOffsets(as_given, given, given.time_offset, kReach, kStep);
  Best other = as_given;
  for (const double field_of_view_rad : FieldsOfView(sample, given)) {
    for (const int sign : {1, -1}) {
      for (int quarters = 0; quarters < 4; ++quarters) {
        SensorOptions options = given;
        options.field_of_view_rad = field_of_view_rad;
        options.bearing_sign = sign;
        options.mount.robot_T_sensor.yaw_rad += quarters * std::numbers::pi / 2;
        if (field_of_view_rad == given.field_of_view_rad) {
          TryOffsets(other, options, given.time_offset, kReach, kStep);
        } else {
          other.Try(options);  // rarely right, so it is not worth all offsets
        }
      }
    }
  }
  SensorOptions found = given;
  if (other.cells() < kClearlySharper * as_given.cells()) {
    found.field_of_view_rad = other.options().field_of_view_rad;
    found.bearing_sign = other.options().bearing_sign;
    found.mount = other.options().mount;
  }
  return found;
}

SensorOptions WithBestTimes(const RecordingSample& sample, const SensorOptions& given) {
  Best best(sample, given);
  const double cells_given = best.cells();
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
    Best best_of_way(sample, way);
    TryOffsets(best_of_way, way, given.time_offset, kMaxTriedOffset, milliseconds(100));
    TryOffsets(best_of_way, way, best_of_way.options().time_offset, milliseconds(75),
               milliseconds(25));
    best.Try(best_of_way.options());
  }
  return best.cells() < kSharper * cells_given ? best.options() : given;
}

double Milliseconds(Utime time) { return static_cast<double>(time.count()) / 1000; }

// What has to be set beside a preset.
config::Scan OptionsBeside(const SensorOptions& preset, const SensorOptions& wanted) {
  config::Scan scan;
  if (wanted.bearing_sign != preset.bearing_sign) scan.set_bearing_sign(wanted.bearing_sign);
  if (wanted.time_offset != preset.time_offset) {
    scan.set_time_offset_ms(Milliseconds(wanted.time_offset));
  }
  if (wanted.use_beam_times != preset.use_beam_times) scan.set_beam_times(wanted.use_beam_times);
  if (!wanted.use_beam_times && wanted.scan_duration != preset.scan_duration) {
    scan.set_scan_duration_ms(Milliseconds(wanted.scan_duration));
  }
  return scan;
}

double YawDegrees(const SensorOptions& options) {
  const double yaw_deg = WrapAngle(options.mount.robot_T_sensor.yaw_rad) * 180 / std::numbers::pi;
  return std::round(yaw_deg * 1e6) / 1e6;
}

}  // namespace

SampleSpread SpreadOf(const RecordingSample& sample, const SensorOptions& options) {
  std::vector<Eigen::Vector2d> hits;
  for (const RangeReadings& readings : sample.scans) {
    if (const auto scan = PrepareScan(readings, options, 0); scan.ok()) {
      PlaceHits(*scan, sample.poses, hits);
    }
  }
  return {hits.size(), HitEntropy(hits)};
}

std::optional<FlagProposal> SearchFlags(const RecordingSample& sample, const SensorOptions& given) {
  if (sample.scans.size() < kMinDriveScans || sample.turned_rad < kMinTurn_rad) return std::nullopt;
  const SampleSpread as_given = SpreadOf(sample, given);
  if (as_given.hits == 0) return std::nullopt;
  FlagProposal proposal;
  proposal.options = WithBestTimes(sample, WithBestDirections(sample, given));
  proposal.spread = SpreadOf(sample, proposal.options).cells;
  proposal.spread_given = as_given.cells;
  SensorOptions flipped = proposal.options;
  flipped.bearing_sign = -flipped.bearing_sign;
  proposal.spread_flipped = SpreadOf(sample, flipped).cells;
  proposal.is_time_beyond =
      std::chrono::abs(proposal.options.time_offset - given.time_offset) >= kMaxTriedOffset - kEdge;
  return proposal;
}

config::Scan ScanWith(const config::Scan& given, const std::string& preset,
                      const SensorOptions& options) {
  std::vector<std::string> presets = PresetNames();
  std::stable_partition(presets.begin(), presets.end(),
                        [&](const std::string& name) { return name == preset; });
  config::Scan beside;
  for (const std::string& name : presets) {
    config::Scan candidate = OptionsBeside(SensorOptionsOf(config::Scan(), name), options);
    candidate.set_preset(name);
    if (!beside.has_preset() || SetFields(candidate).size() < SetFields(beside).size()) {
      beside = candidate;
    }
  }
  config::Scan scan = given;
  scan.clear_bearing_sign();
  scan.clear_time_offset_ms();
  scan.clear_scan_duration_ms();
  scan.clear_beam_times();
  scan.MergeFrom(beside);
  if (options.field_of_view_rad > 0) {
    scan.set_fov_deg(std::round(options.field_of_view_rad * 180 / std::numbers::pi));
  }
  if (!scan.has_extrinsics_channel()) {
    scan.clear_yaw_deg();
    if (const double yaw_deg = YawDegrees(options); yaw_deg != 0) scan.set_yaw_deg(yaw_deg);
  }
  return scan;
}

}  // namespace splinemap
