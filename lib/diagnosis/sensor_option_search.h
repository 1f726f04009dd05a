#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "lib/config/config.h"
#include "lib/diagnosis/recording_sample.h"
#include "splinemap/sensor_options.h"

namespace splinemap {

// Spread of the hits of all scans of the sample, read and placed with `options`.
struct SampleSpread {
  size_t hits = 0;
  double cells = 0;  // as HitEntropy()
};
SampleSpread SpreadOf(const RecordingSample& sample, const SensorOptions& options);

// Of fewer scans nothing is told.
inline constexpr size_t kMinDriveScans = 10;
// A spread below this share of another's is no accident.
inline constexpr double kClearlySharper = 0.8;
// Times that make the map sharper by less are not worth being set, nor is a part of the mount.
inline constexpr double kSharper = 0.95;

// The options under which a drive gives the sharpest map.
struct FlagProposal {
  SensorOptions options;
  double spread = 0;          // with them
  double spread_given = 0;    // with those given
  double spread_flipped = 0;  // with `options` and the other sign of bearing
  // The sharpest time offset is the last one that was tried: the right one lies further off, and
  // nothing else can be told before it is found.
  bool is_time_beyond = false;
};

// Tries wider fields of view, both signs of bearing, where the sensor sits and looks to, time
// offsets up to a second to both sides, scan durations and beam times. What makes no clear
// difference stays as given: 20 % for fields of view, sign and mount, 5 % for times. Nothing where
// the sample tells nothing: fewer than 10 scans, a robot that turned by less than 30 degrees, no
// hits.
std::optional<FlagProposal> SearchFlags(const RecordingSample& sample, const SensorOptions& given);

// `given` with the options that a search may change replaced by those of `options`. Names the
// preset that leaves the fewest of them to set, `preset` where others do as well. Where extrinsics
// come from a channel, the mount of the sensor is left to it.
config::Scan ScanWith(const config::Scan& given, const std::string& preset,
                      const SensorOptions& options);

}  // namespace splinemap
