#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "splinemap/pose2.h"
#include "splinemap/utime.h"

namespace splinemap {

// One sweep of the front laser of a CARMEN log.
struct CarmenScan {
  std::vector<float> ranges_m;   // infinity where the log says that nothing was hit
  double first_bearing_rad = 0;  // from the laser's x axis
  double bearing_step_rad = 0;   // counter-clockwise
  Pose2 world_T_laser;           // corrected, where the log was corrected
  double time_s = 0;             // as logged, see RepairTimes
};

struct CarmenLog {
  std::vector<CarmenScan> scans;
  // What the scans were read from: FLASER, ROBOTLASER1 or RAWLASER1. The poses of the last are
  // those of ODOM lines.
  std::string kind;
  // Of FLASER lines, which do not say it: what was assumed, and whether nothing in the log, nor
  // what is known of scanners with so many beams, says so.
  double field_of_view_rad = 0;
  bool field_of_view_is_guessed = false;
  int64_t other_scans = 0;         // of other kinds of lines, left out
  int64_t scans_without_pose = 0;  // RAWLASER1 lines before the first ODOM line
  int64_t broken_lines = 0;        // of the kind read, and skipped
  int64_t first_broken_line = 0;   // counted from 1
  bool ends_early = false;         // the compressed file is cut off
};

// Reads a CARMEN log, plain or gzip, with any line ends: of FLASER and ROBOTLASER1 lines those of
// which there are more, or, where there are neither, RAWLASER1 lines at the poses of the ODOM lines
// around them. Lines that are cut short or hold no numbers are skipped and counted. Readings at the
// maximum that ROBOTLASER1 and RAWLASER1 lines or, for FLASER, `PARAM robot_front_laser_max` name
// are no returns. The field of view of FLASER lines is `field_of_view_rad`, or else that of the
// log's `PARAM laser_front_laser_fov` or `_resolution`, or else what scanners with so many beams
// have, or else half a turn.
//
// InvalidArgument, with the reason, where no scan is found. `progress` is called now and then with
// the share of the file read, 0 .. 1.
absl::StatusOr<CarmenLog> ReadCarmenLog(const std::string& path,
                                        std::optional<double> field_of_view_rad,
                                        absl::FunctionRef<void(double)> progress);

struct RepairedTimes {
  std::vector<Utime> utimes;  // strictly increasing
  int64_t replaced = 0;       // steps that were replaced
};

// Time stamps of recorded scans as they should have been: a step that is not positive (stamps that
// stand still, go back, overflow or are 0) or longer than ten minutes becomes 1 / rate_hz. Requires
// rate_hz > 0.
RepairedTimes RepairTimes(const std::vector<CarmenScan>& scans, double rate_hz);

// Writes an LCM log of the scans on LASER and their poses on POSE, as bot_core messages with these
// time stamps, one a scan.
absl::Status WriteAsLcmLog(const CarmenLog& log, const std::vector<Utime>& utimes,
                           const std::string& path);

}  // namespace splinemap
