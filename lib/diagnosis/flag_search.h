#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "lib/config/config.h"
#include "lib/sensing/pose_buffer.h"
#include "lib/sensing/scan.h"
#include "lib/sensing/sensor_options.h"

namespace splinemap {

// Some seconds of a drive, to try flags on: scans with poses around them, no two from nearly the
// same place. Bounded memory. Thread-compatible.
class DriveSample {
 public:
  // Keeps at most `max_scans` scans of about `max_beams` beams each.
  DriveSample(size_t max_scans, size_t max_beams);

  // In the order of arrival. `time_offset`: what brings scans to the clock of the poses, roughly.
  void AddPose(const TimedPose& pose);
  void AddScan(RangeReadings readings, Utime time_offset);

  // Scans that are complete: with poses far enough before and after to try time offsets.
  const std::vector<RangeReadings>& scans() const { return scans_; }
  const PoseBuffer& poses() const { return poses_; }
  bool full() const { return scans_.size() >= max_scans_; }

  // From one scan to the next, summed.
  double turned_rad() const { return turned_rad_; }

 private:
  bool IsNewPlace(const Pose2& world_T_robot);
  void KeepScans();

  size_t max_scans_;
  size_t max_beams_;
  PoseBuffer poses_;
  std::deque<std::pair<RangeReadings, Utime>> waiting_;  // for later poses; with time offset
  std::vector<RangeReadings> scans_;
  std::optional<Pose2> last_place_;
  double turned_rad_ = 0;
};

// Spread of the hits of all scans of the sample, read and placed with `options`.
double SpreadOf(const DriveSample& sample, const SensorOptions& options);

// The options under which a drive gives the sharpest map.
struct FlagProposal {
  SensorOptions options;
  double spread = 0;          // with them
  double spread_given = 0;    // with those given
  double spread_flipped = 0;  // with `options` and the other sign of bearing
};

// Tries both signs of bearing, the sensor turned by quarters, time offsets up to a second to both
// sides, scan durations and beam times. What makes no clear difference stays as given: 20 % for
// sign and quarter turns, 5 % for times. Nothing where the sample is too small: fewer than 10
// scans, or the robot turned by less than 30 degrees.
std::optional<FlagProposal> SearchFlags(const DriveSample& sample, const SensorOptions& given);

// How to write options on the command line: "LIDAR:michigan_2017,time_offset_ms=-100". Names the
// preset that leaves the fewest options to set, `preset` where others do as well. What a search
// does not change is not looked at.
std::string ScanFlag(const std::string& channel, const std::string& preset,
                     const SensorOptions& options);

}  // namespace splinemap
