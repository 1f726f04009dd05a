#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "lib/sensing/pose_buffer.h"
#include "splinemap/scan.h"

namespace splinemap {

// Some seconds of a drive, to try flags on: scans with poses around them, no two from nearly the
// same place.
struct RecordingSample {
  std::vector<RangeReadings> scans;
  PoseBuffer poses{std::chrono::years(300)};  // none is too old
  double turned_rad = 0;                      // from one scan to the next, summed
};

// The readings in at most `max_beams` beams, evenly chosen.
RangeReadings Thinned(RangeReadings readings, size_t max_beams);

// Whether there are poses before and after, far enough to try time offsets of a second, and neither
// a gap nor a jump nor a tilted robot at `utime`.
bool HasPosesAround(const PoseBuffer& poses, Utime utime);

// A sample of scans that are there with all poses. `time_offset` brings the scans to the clock of
// the poses, roughly.
RecordingSample SampleOf(const std::vector<RangeReadings>& scans, const PoseBuffer& poses,
                         Utime time_offset, size_t max_scans);

// Tells places that are new from nearly the same as the last.
class PlaceFilter {
 public:
  bool IsNew(const Pose2& world_T_robot);
  double turned_rad() const { return turned_rad_; }  // between places, summed

 private:
  std::optional<Pose2> last_;
  double turned_rad_ = 0;
};

// Picks a sample from messages in the order of arrival. Keeps poses of the last seconds and those
// around the scans that it picked: memory and time per message are bounded. Thread-compatible.
class DriveCollector {
 public:
  DriveCollector(size_t max_scans, size_t max_beams)
      : max_scans_(max_scans), max_beams_(max_beams) {}

  void AddPose(const TimedPose& pose);
  // `time_offset` as in SampleOf().
  void AddScan(RangeReadings readings, Utime time_offset);

  const RecordingSample& sample() const { return sample_; }
  bool full() const { return sample_.scans.size() >= max_scans_; }

 private:
  void KeepScans();
  void Keep(RangeReadings readings, Utime utime);

  size_t max_scans_;
  size_t max_beams_;
  RecordingSample sample_;
  PoseBuffer recent_{std::chrono::seconds(10)};
  std::deque<std::pair<RangeReadings, Utime>> waiting_;  // for later poses; with time offset
  PlaceFilter places_;
};

}  // namespace splinemap
