#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "lib/sensing/pose_buffer.h"
#include "lib/sensing/scan.h"

namespace splinemap {

// Some seconds of a drive, to try flags on: scans with poses around them, no two from nearly the
// same place.
struct DriveSample {
  std::vector<RangeReadings> scans;
  PoseBuffer poses{std::chrono::hours(24)};
  double turned_rad = 0;  // from one scan to the next, summed
};

// The readings in at most `max_beams` beams, evenly chosen.
RangeReadings Thinned(RangeReadings readings, size_t max_beams);

// Whether there are poses before and after, far enough to try time offsets of a second, and no gap
// at `utime`.
bool HasPosesAround(const PoseBuffer& poses, Utime utime);

// Picks a sample from messages in the order of arrival. Memory is bounded. Thread-compatible.
class DriveCollector {
 public:
  DriveCollector(size_t max_scans, size_t max_beams)
      : max_scans_(max_scans), max_beams_(max_beams) {}

  void AddPose(const TimedPose& pose);
  // `time_offset`: what brings scans to the clock of the poses, roughly.
  void AddScan(RangeReadings readings, Utime time_offset);

  const DriveSample& sample() const { return sample_; }
  bool full() const { return sample_.scans.size() >= max_scans_; }

 private:
  void KeepScans();
  bool IsNewPlace(const Pose2& world_T_robot);

  size_t max_scans_;
  size_t max_beams_;
  DriveSample sample_;
  std::deque<std::pair<RangeReadings, Utime>> waiting_;  // for later poses; with time offset
  std::optional<Pose2> last_place_;
};

}  // namespace splinemap
