#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "splinemap/pose2.h"
#include "splinemap/utime.h"

namespace splinemap {

// One sweep of the front laser of a CARMEN log.
struct CarmenScan {
  std::vector<float> ranges_m;
  double first_bearing_rad = 0;  // from the laser's x axis
  double bearing_step_rad = 0;   // counter-clockwise
  Pose2 world_T_laser;           // corrected, where the log was corrected
  double time_s = 0;             // as logged, see RepairTimes
};

struct CarmenLog {
  std::vector<CarmenScan> scans;
  int64_t broken_lines = 0;       // of the kind read, and skipped
  int64_t first_broken_line = 0;  // counted from 1
  bool ends_early = false;        // the compressed file is cut off
};

// Reads a CARMEN log, plain or gzip: its FLASER lines, or where it has none its ROBOTLASER1 lines.
// Lines that are cut short or hold no numbers are skipped and counted. InvalidArgument where no
// scan is found. `progress` is called now and then with the share of the file read, 0 .. 1.
absl::StatusOr<CarmenLog> ReadCarmenLog(const std::string& path,
                                        absl::FunctionRef<void(double)> progress);

struct RepairedTimes {
  std::vector<Utime> utimes;  // strictly increasing
  int64_t replaced = 0;       // steps that were replaced
};

// Time stamps of recorded scans as they should have been: a step that is not positive (stamps that
// stand still, go back, overflow or are 0) or longer than ten minutes becomes 1 / rate_hz. Requires
// rate_hz > 0.
RepairedTimes RepairTimes(const std::vector<CarmenScan>& scans, double rate_hz);

}  // namespace splinemap
