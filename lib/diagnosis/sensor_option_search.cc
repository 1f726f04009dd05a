#include "lib/diagnosis/sensor_option_search.h"

#include <algorithm>
#include <cmath>
#include <future>
#include <numbers>
#include <utility>

#include "absl/types/span.h"
#include "lib/config/checked_text.h"
#include "lib/diagnosis/hit_entropy.h"
#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr double kDegree_rad = std::numbers::pi / 180;
constexpr double kMinTurn_rad = 30 * kDegree_rad;

constexpr Utime kMaxTriedOffset = seconds(1);
// So near to it, the best of the tried offsets is the edge and no optimum.
constexpr Utime kEdge = milliseconds(150);

bool HasBeamTimes(const RecordingSample& sample) {
  return std::all_of(sample.scans.begin(), sample.scans.end(), &HaveUsefulBeamTimes);
}

// Appends the hits of a scan. Poses between those of the first and the last beam are interpolated
// between these two, which is near enough to compare flags. `placed` is memory to work in.
void PlaceHits(Scan scan, const PoseBuffer& poses, std::vector<PlacedBeam>& placed,
               std::vector<Eigen::Vector2d>& hits) {
  const Utime first = scan.utime + scan.first_beam;
  const Utime last = scan.utime + scan.last_beam;
  const auto at_first = poses.Find(first);
  const auto at_last = first == last ? at_first : poses.Find(last);
  if (!at_first || !at_last || poses.IsInJump(first)) return;
  if (first != last && poses.IsInJump(last)) return;
  const Eigen::Vector3d up_robot = InterpolateUp(*at_first, first);
  if (IsTiltedTooMuch(up_robot)) return;
  const Pose2 from = Interpolate(*at_first, first) * scan.robot_T_sensor;
  const Pose2 to = Interpolate(*at_last, last) * scan.robot_T_sensor;
  std::vector<Pose2> world_T_sensor;
  if (first == last) {
    world_T_sensor = {from};
  } else {
    const double turned_rad = WrapAngle(to.yaw_rad - from.yaw_rad);
    world_T_sensor.reserve(scan.beams.size());
    for (const Beam& beam : scan.beams) {
      const double passed = static_cast<double>((beam.time_offset - scan.first_beam).count()) /
                            static_cast<double>((last - first).count());
      world_T_sensor.push_back({from.position_m + passed * (to.position_m - from.position_m),
                                from.yaw_rad + passed * turned_rad});
    }
  }
  Level(scan.robot_T_sensor.yaw_rad, up_robot, absl::MakeSpan(scan.beams));
  Place(scan.beams, world_T_sensor, placed);
  for (const PlacedBeam& beam : placed) {
    if (beam.hit) hits.push_back(beam.origin_world_m + beam.range_m * beam.direction_world);
  }
}

// The sharpest of some options so far.
class Best {
 public:
  Best(const RecordingSample& sample, const SensorOptions& options)
      : sample_(&sample), options_(options), spread_(SpreadOf(sample, options)) {}

  // Keeps `options` where they are sharper than what it has. Hits that are not placed do not make a
  // map sharp.
  bool Try(const SensorOptions& options) {
    const SampleSpread spread = SpreadOf(*sample_, options);
    if (spread.hits < spread_.hits || spread.cells >= spread_.cells) return false;
    options_ = options;
    spread_ = spread;
    return true;
  }
  const RecordingSample& sample() const { return *sample_; }
  const SensorOptions& options() const { return options_; }
  double cells() const { return spread_.cells; }

 private:
  const RecordingSample* sample_;
  SensorOptions options_;
  SampleSpread spread_;
};

const Best& SharperOf(const Best& one, const Best& other) {
  return other.cells() < one.cells() ? other : one;
}

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

// A number of the options that is moved by small steps.
using Dial = void (*)(SensorOptions& options, int steps);

void MoveTimeOffset(SensorOptions& options, int steps) {
  options.time_offset += milliseconds(steps);
}
void MoveDuration(SensorOptions& options, int steps) {
  if (!options.use_beam_times) options.scan_duration += milliseconds(2 * steps);
}
void MoveYaw(SensorOptions& options, int steps) {
  options.mount.robot_T_sensor.yaw_rad += 0.5 * kDegree_rad * steps;
}
void MoveX(SensorOptions& options, int steps) {
  options.mount.robot_T_sensor.position_m.x() += 0.005 * steps;
}
void MoveY(SensorOptions& options, int steps) {
  options.mount.robot_T_sensor.position_m.y() += 0.005 * steps;
}

constexpr Dial kOffset[] = {&MoveTimeOffset};
constexpr Dial kTimes[] = {&MoveTimeOffset, &MoveDuration};
constexpr Dial kMount[] = {&MoveYaw, &MoveX, &MoveY};
constexpr Dial kOffsetAndMount[] = {&MoveTimeOffset, &MoveYaw, &MoveX, &MoveY};
constexpr Dial kAll[] = {&MoveTimeOffset, &MoveDuration, &MoveYaw, &MoveX, &MoveY};

// Turns each dial while that makes the map sharper, by ever smaller steps.
void Refine(Best& best, absl::Span<const Dial> dials, int first_steps = 32) {
  constexpr int kMostRounds = 4;
  for (int steps = first_steps; steps > 0; steps /= 2) {
    bool is_better = true;
    for (int round = 0; is_better && round < kMostRounds; ++round) {
      is_better = false;
      for (const Dial& dial : dials) {
        SensorOptions more = best.options();
        dial(more, steps);
        SensorOptions less = best.options();
        dial(less, -steps);
        is_better |= best.Try(more) || best.Try(less);
      }
    }
  }
}

// Scan durations and beam times.
std::vector<SensorOptions> AllWaysOfTime(const RecordingSample& sample,
                                         const SensorOptions& given) {
  std::vector<SensorOptions> ways{given};
  for (const int duration_ms : {0, 100, 200, -100, -200}) {
    ways.push_back(given);
    ways.back().use_beam_times = false;
    ways.back().scan_duration = milliseconds(duration_ms);
  }
  if (HasBeamTimes(sample)) {
    ways.push_back(given);
    ways.back().use_beam_times = true;
  }
  return ways;
}

std::vector<SensorOptions> AllYaws(const SensorOptions& given) {
  constexpr int kStep_deg = 15;
  std::vector<SensorOptions> yaws;
  for (int yaw_deg = 0; yaw_deg < 360; yaw_deg += kStep_deg) {
    yaws.push_back(given);
    yaws.back().mount.robot_T_sensor.yaw_rad += yaw_deg * kDegree_rad;
  }
  return yaws;
}

// Fewer scans and beams, which are enough for rough values.
RecordingSample Sparse(const RecordingSample& sample) {
  constexpr size_t kScans = 40;
  constexpr size_t kBeams = 45;
  RecordingSample sparse;
  sparse.poses = sample.poses;
  const size_t step = (sample.scans.size() + kScans - 1) / kScans;
  for (size_t k = 0; k < sample.scans.size(); k += step) {
    sparse.scans.push_back(Thinned(sample.scans[k], kBeams));
  }
  return sparse;
}

// The first that is nearly as sharp as the last and sharpest.
const Best& SimplestOf(std::initializer_list<const Best*> from_simple_to_sharp) {
  const Best& sharpest = *std::data(from_simple_to_sharp)[from_simple_to_sharp.size() - 1];
  return **std::find_if(
      from_simple_to_sharp.begin(), from_simple_to_sharp.end(),
      [&](const Best* simple) { return kSharper * simple->cells() <= sharpest.cells(); });
}

// What of the mount hardly matters stays as given; the rest is refined once more.
SensorOptions WithFewestOfMount(const Best& found, const SensorOptions& given) {
  const Pose2& mount = given.mount.robot_T_sensor;
  const std::pair<Dial, void (*)(Pose2&, const Pose2&)> parts[] = {
      {&MoveX, [](Pose2& to, const Pose2& from) { to.position_m.x() = from.position_m.x(); }},
      {&MoveY, [](Pose2& to, const Pose2& from) { to.position_m.y() = from.position_m.y(); }},
      {&MoveYaw, [](Pose2& to, const Pose2& from) { to.yaw_rad = from.yaw_rad; }}};
  std::vector<Dial> dials;
  if (found.options().time_offset != given.time_offset) dials.push_back(&MoveTimeOffset);
  SensorOptions fewest = found.options();
  for (const auto& [dial, copy] : parts) {
    SensorOptions simpler = fewest;
    copy(simpler.mount.robot_T_sensor, mount);
    const bool hardly_matters = kSharper * SpreadOf(found.sample(), simpler).cells <= found.cells();
    if (hardly_matters) fewest = simpler;
    if (!hardly_matters) dials.push_back(dial);
  }
  Best refined(found.sample(), fewest);
  Refine(refined, dials, 4);
  return refined.options();
}

// The times and the mount of the sensor, as few of them as a map that is nearly as sharp as the
// sharpest takes.
SensorOptions WithBestTimesAndMount(const RecordingSample& sample, const SensorOptions& given) {
  const RecordingSample sparse = Sparse(sample);
  const auto roughly = [&](const std::vector<SensorOptions>& ways, Utime reach) {
    Best rough(sparse, given);
    for (const SensorOptions& way : ways) {
      TryOffsets(rough, way, given.time_offset, reach, milliseconds(100));
    }
    return rough.options();
  };
  const Best as_given(sample, given);
  std::future<Best> found_beside = std::async(std::launch::async, [&] {
    Best offset_and_mount(sample, roughly(AllYaws(given), kMaxTriedOffset));
    Refine(offset_and_mount, kOffsetAndMount);
    return offset_and_mount;
  });
  Best offset = as_given;
  offset.Try(roughly({given}, kMaxTriedOffset));
  Refine(offset, kOffset);
  Best times = offset;
  times.Try(roughly(AllWaysOfTime(sample, given), kMaxTriedOffset));
  Refine(times, kTimes);
  const Best& only_times = SimplestOf({&as_given, &offset, &times});

  Best mount = as_given;
  mount.Try(roughly(AllYaws(given), Utime(0)));
  Refine(mount, kMount);
  const Best offset_and_mount = found_beside.get();
  Best all = SharperOf(SharperOf(times, mount), offset_and_mount);
  Refine(all, kAll);
  const Best& with_mount = SimplestOf({&mount, &offset_and_mount, &all});

  if (with_mount.cells() >= kClearlySharper * only_times.cells()) return only_times.options();
  return WithFewestOfMount(with_mount, given);
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

// To the micrometre and microdegree.
void SetMount(const Pose2& robot_T_sensor, config::Scan& scan) {
  const auto rounded = [](double value) { return std::round(value * 1e6) / 1e6; };
  const double yaw_deg = rounded(WrapAngle(robot_T_sensor.yaw_rad) / kDegree_rad);
  const double x_m = rounded(robot_T_sensor.position_m.x());
  const double y_m = rounded(robot_T_sensor.position_m.y());
  scan.clear_x_m();
  scan.clear_y_m();
  scan.clear_yaw_deg();
  if (x_m != 0) scan.set_x_m(x_m);
  if (y_m != 0) scan.set_y_m(y_m);
  if (yaw_deg != 0) scan.set_yaw_deg(yaw_deg);
}

}  // namespace

SampleSpread SpreadOf(const RecordingSample& sample, const SensorOptions& options) {
  std::vector<Eigen::Vector2d> hits;
  hits.reserve(sample.scans.size() * (sample.scans.empty() ? 0 : sample.scans[0].ranges_m.size()));
  std::vector<PlacedBeam> placed;
  for (const RangeReadings& readings : sample.scans) {
    if (auto scan = PrepareScan(readings, options, 0); scan.ok()) {
      PlaceHits(*std::move(scan), sample.poses, placed, hits);
    }
  }
  return {hits.size(), HitEntropy(hits)};
}

std::optional<FlagProposal> SearchFlags(const RecordingSample& sample, const SensorOptions& given) {
  if (sample.scans.size() < kMinDriveScans || sample.turned_rad < kMinTurn_rad) return std::nullopt;
  const SampleSpread as_given = SpreadOf(sample, given);
  if (as_given.hits == 0) return std::nullopt;
  FlagProposal proposal;
  proposal.options = WithBestTimesAndMount(sample, WithBestDirections(sample, given));
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
    SetMount(options.mount.robot_T_sensor, scan);
  }
  return scan;
}

}  // namespace splinemap
