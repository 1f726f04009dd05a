#include "lib/sensing/scan.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "lib/base/status.h"

namespace splinemap {
namespace {

// What a reading means, or nothing.
std::optional<Beam> Interpret(float range_m, const SensorOptions& options) {
  Beam beam;
  // A reading of 0 is the commonest way to say "no return", beside infinity and the maximum.
  const bool no_return = range_m == 0 || range_m >= options.range_max_m;
  if (no_return) {
    if (!options.no_return_is_free) return std::nullopt;
    beam.range_m = static_cast<float>(options.range_max_m);
    beam.hit = false;
    return beam;
  }
  if (!(range_m >= options.range_min_m)) return std::nullopt;  // also NaN
  beam.range_m = range_m;
  return beam;
}

Utime BeamTime(const RangeReadings& readings, const SensorOptions& options, size_t k) {
  if (options.use_beam_times) return readings.beam_utimes[k] - readings.utime;
  const auto last = static_cast<int64_t>(readings.ranges_m.size()) - 1;
  return last > 0 ? options.scan_duration * static_cast<int64_t>(k) / last : Utime(0);
}

}  // namespace

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
  scan.robot_T_sensor = options.robot_T_sensor;
  scan.beams.reserve(count);
  for (size_t k = 0; k < count; ++k) {
    std::optional<Beam> beam = Interpret(readings.ranges_m[k], options);
    if (!beam || !std::isfinite(readings.bearings_rad[k])) continue;
    beam->bearing_rad = static_cast<float>(options.bearing_sign) * readings.bearings_rad[k];
    beam->time_offset = BeamTime(readings, options, k);
    if (std::chrono::abs(beam->time_offset) > kMaxBeamTimeOffset) {
      return InvalidArgument("beam time {:.1f} s away from the scan's; set beam_times: false",
                             static_cast<double>(beam->time_offset.count()) * 1e-6);
    }
    scan.first_beam = std::min(scan.first_beam, beam->time_offset);
    scan.last_beam = std::max(scan.last_beam, beam->time_offset);
    scan.beams.push_back(*beam);
  }
  return scan;
}

}  // namespace splinemap
