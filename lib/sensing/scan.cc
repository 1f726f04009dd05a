#include "splinemap/scan.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "lib/base/status.h"
#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// The limits of SensorOptions as floats: a sensor that reports its maximum reports that float.
struct RangeLimits {
  explicit RangeLimits(const SensorOptions& options)
      : no_return_up_to_m(static_cast<float>(options.no_return_up_to_m)),
        min_m(static_cast<float>(options.range_min_m)),
        max_m(static_cast<float>(options.range_max_m)),
        no_return_is_free(options.no_return_is_free) {}

  float no_return_up_to_m;
  float min_m;
  float max_m;
  bool no_return_is_free;
};

// Sets range and hit to what a reading means; false where it means nothing.
bool Interpret(float range_m, const RangeLimits& limits, Beam& beam) {
  // A reading of 0 is the commonest way to say "no return", beside infinity and the maximum.
  beam.hit = !((range_m >= 0 && range_m <= limits.no_return_up_to_m) || range_m >= limits.max_m);
  beam.range_m = beam.hit ? range_m : limits.max_m;
  return beam.hit ? range_m >= limits.min_m : limits.no_return_is_free;  // NaN: a hit, and no more
}

bool IsMasked(double bearing_rad, const std::vector<BearingRange>& masks) {
  return std::any_of(masks.begin(), masks.end(), [&](const BearingRange& mask) {
    const double past_from_rad = WrapAngle(bearing_rad - mask.from_rad);
    return (past_from_rad < 0 ? past_from_rad + 2 * std::numbers::pi : past_from_rad) <=
           mask.span_rad;
  });
}

// From the scan's time stamp; nothing where it is too far away to be true.
std::optional<Utime> BeamTime(const RangeReadings& readings, const SensorOptions& options,
                              size_t k) {
  if (options.use_beam_times) {
    const Utime utime = readings.beam_utimes[k];
    const bool is_near = utime >= readings.utime - kMaxBeamTimeOffset &&
                         utime <= readings.utime + kMaxBeamTimeOffset;
    return is_near ? std::optional(utime - readings.utime) : std::nullopt;
  }
  const auto last = static_cast<int64_t>(readings.ranges_m.size()) - 1;
  return last > 0 ? options.scan_duration * static_cast<int64_t>(k) / last : Utime(0);
}

}  // namespace

double FieldOfView(absl::Span<const float> bearings_rad) {
  if (bearings_rad.size() < 2) return 0;
  const auto intervals = static_cast<double>(bearings_rad.size() - 1);
  const double span_rad = double{bearings_rad.back()} - double{bearings_rad.front()};
  const double step_rad = span_rad / intervals;
  for (size_t k = 1; k < bearings_rad.size(); ++k) {
    const double expected_rad = double{bearings_rad[0]} + static_cast<double>(k) * step_rad;
    if (!(std::abs(double{bearings_rad[k]} - expected_rad) < 1e-3)) return 0;
  }
  return std::abs(bearings_rad.size() % 2 == 1 ? span_rad : span_rad + step_rad);
}

RangeReadings At(RangeReadings readings, Utime utime) {
  for (Utime& beam_utime : readings.beam_utimes) {
    // Times that are far off may be any numbers.
    const bool is_near = beam_utime >= readings.utime - kMaxBeamTimeOffset &&
                         beam_utime <= readings.utime + kMaxBeamTimeOffset;
    beam_utime = is_near ? utime + (beam_utime - readings.utime) : utime;
  }
  readings.utime = utime;
  return readings;
}

bool HaveUsefulBeamTimes(const RangeReadings& readings) {
  const std::vector<Utime>& times = readings.beam_utimes;
  if (times.size() < 2) return false;
  const auto [least, greatest] = std::minmax_element(times.begin(), times.end());
  return *least >= readings.utime - kMaxBeamTimeOffset &&
         *greatest <= readings.utime + kMaxBeamTimeOffset && *greatest - *least >= milliseconds(10);
}

void Place(absl::Span<const Beam> beams, absl::Span<const Pose2> world_T_sensor,
           std::vector<PlacedBeam>& placed) {
  constexpr size_t kBlock = 128;
  std::array<double, kBlock> bearings_world_rad;
  std::array<Eigen::Vector2d, kBlock> directions_world;
  const size_t poses_per_beam = world_T_sensor.size() == 1 ? 0 : 1;
  placed.resize(beams.size());
  for (size_t begin = 0; begin < beams.size(); begin += kBlock) {
    // Plain pointers: spans are checked at each beam.
    const size_t count = std::min(kBlock, beams.size() - begin);
    const Beam* const some = &beams[begin];
    const Pose2* const poses = &world_T_sensor[begin * poses_per_beam];
    PlacedBeam* const some_placed = &placed[begin];
    for (size_t k = 0; k < count; ++k) {
      bearings_world_rad[k] = poses[k * poses_per_beam].yaw_rad + double{some[k].bearing_rad};
    }
    UnitVectors({bearings_world_rad.data(), count}, absl::MakeSpan(directions_world));
    for (size_t k = 0; k < count; ++k) {
      some_placed[k] = {poses[k * poses_per_beam].position_m, directions_world[k],
                        double{some[k].range_m}, some[k].hit};
    }
  }
}

bool IsTiltedTooMuch(const Eigen::Vector3d& up_robot) {
  constexpr double kLeastUp = 0.984807753;  // cos 10 degrees
  return std::abs(up_robot.z()) < kLeastUp;
}

// A beam's direction d in the robot's frame is Ry(pitch) Rx(roll) d in the world, before its yaw.
void Level(double sensor_yaw_rad, const Eigen::Vector3d& up_robot, absl::Span<Beam> beams) {
  // Half a degree: a beam of 30 m gets a millimetre shorter.
  constexpr double kLevelUp = 0.99996;
  if (up_robot.z() >= kLevelUp) return;
  const double sin_pitch = -up_robot.x();
  const double cos_pitch = std::sqrt(1 - sin_pitch * sin_pitch);
  const double sin_roll = up_robot.y() / cos_pitch;
  const double cos_roll = up_robot.z() / cos_pitch;
  for (Beam& beam : beams) {
    const Eigen::Vector2d d = UnitVector(sensor_yaw_rad + double{beam.bearing_rad});
    const double x = cos_pitch * d.x() + sin_pitch * sin_roll * d.y();
    const double y = cos_roll * d.y();
    beam.bearing_rad = static_cast<float>(WrapAngle(AngleOf(x, y) - sensor_yaw_rad));
    beam.range_m *= static_cast<float>(std::sqrt(x * x + y * y));
  }
}

absl::StatusOr<Scan> PrepareScan(const RangeReadings& readings, const SensorOptions& options,
                                 int channel) {
  const size_t count = readings.ranges_m.size();
  if (count > kMaxBeams) {
    return InvalidArgument("scan of {} beams; {} are the most", count, kMaxBeams);
  }
  if (options.use_beam_times && readings.beam_utimes.size() != count) {
    return InvalidArgument("scan without beam times; set beam_times: false");
  }
  Scan scan;
  scan.channel = channel;
  scan.utime = readings.utime + options.time_offset;
  scan.robot_T_sensor = options.mount.robot_T_sensor;
  const int sign = options.mount.is_upside_down ? -options.bearing_sign : options.bearing_sign;
  const double seen_rad = options.field_of_view_rad > 0 ? FieldOfView(readings.bearings_rad) : 0;
  const auto stretch =
      static_cast<float>(seen_rad > 0 ? sign * options.field_of_view_rad / seen_rad : sign);
  const RangeLimits limits(options);
  const bool has_times = options.use_beam_times || options.scan_duration != Utime(0);
  scan.beams.resize(count);
  size_t kept = 0;
  for (size_t k = 0; k < count; k += options.every_nth_beam) {
    Beam& beam = scan.beams[kept];
    if (!Interpret(readings.ranges_m[k], limits, beam)) continue;
    if (!std::isfinite(readings.bearings_rad[k])) continue;
    beam.bearing_rad = stretch * readings.bearings_rad[k];
    if (IsMasked(beam.bearing_rad, options.masks)) continue;
    if (has_times) {
      const std::optional<Utime> time_offset = BeamTime(readings, options, k);
      if (!time_offset) {
        return InvalidArgument(
            "a beam time more than 2 s away from the scan's; set beam_times: false");
      }
      beam.time_offset = *time_offset;
      scan.first_beam = std::min(scan.first_beam, beam.time_offset);
      scan.last_beam = std::max(scan.last_beam, beam.time_offset);
    }
    beam.reading = static_cast<uint16_t>(k);
    ++kept;
  }
  scan.beams.resize(kept);
  // Scans may wait for poses by the thousand.
  if (scan.beams.size() < scan.beams.capacity() / 4 * 3) scan.beams.shrink_to_fit();
  return scan;
}

}  // namespace splinemap
