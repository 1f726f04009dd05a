#include "lib/logs/carmen_log.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "absl/strings/numbers.h"
#include "lib/base/status.h"
#include "lib/logs/gz_file.h"

namespace splinemap {
namespace {

constexpr double kMaxStepSeconds = 600;
constexpr double kMaxSeconds = 4e9;
constexpr size_t kMaxReadings = 16384;

// Takes words off a line. After a word that is missing or no number, ok() is false.
class LineReader {
 public:
  explicit LineReader(std::string_view line) : rest_(line) {}

  std::string_view Word() {
    const size_t begin = rest_.find_first_not_of(" \t\r\n");
    if (begin == std::string_view::npos) {
      ok_ = false;
      return {};
    }
    const size_t end = std::min(rest_.find_first_of(" \t\r\n", begin), rest_.size());
    const std::string_view word = rest_.substr(begin, end - begin);
    rest_.remove_prefix(end);
    return word;
  }

  double Number() {
    const std::string_view word = Word();
    double value = 0;
    // SimpleAtod takes "nan" and "inf", which are readings, too.
    if (!absl::SimpleAtod({word.data(), word.size()}, &value)) ok_ = false;
    return value;
  }

  std::vector<float> Numbers() {
    const double count = Number();
    if (!ok_ || !(count >= 0 && count <= kMaxReadings)) {
      ok_ = false;
      return {};
    }
    std::vector<float> values;
    for (int k = 0; ok_ && k < count; ++k) values.push_back(static_cast<float>(Number()));
    return values;
  }

  Pose2 Pose() {
    const double x = Number();
    const double y = Number();
    return {{x, y}, Number()};
  }

  bool ok() const { return ok_; }

 private:
  std::string_view rest_;
  bool ok_ = true;
};

std::optional<CarmenScan> Checked(CarmenScan scan, const LineReader& line) {
  const bool finite = scan.world_T_laser.position_m.allFinite() &&
                      std::isfinite(scan.world_T_laser.yaw_rad) &&
                      std::isfinite(scan.first_bearing_rad) && std::isfinite(scan.bearing_step_rad);
  if (!line.ok() || !finite || scan.ranges_m.empty()) return std::nullopt;
  return scan;
}

// FLASER n r_1 .. r_n x y theta odom_x odom_y odom_theta ipc_time host logger_time
std::optional<CarmenScan> ParseFlaser(std::string_view text) {
  LineReader line(text);
  line.Word();
  CarmenScan scan;
  scan.ranges_m = line.Numbers();
  scan.world_T_laser = line.Pose();
  line.Pose();  // odometry
  line.Number();
  line.Word();
  scan.time_s = line.Number();
  // The format has no angles: half a turn, with or without a beam at its end.
  const auto count = static_cast<double>(scan.ranges_m.size());
  const double intervals = scan.ranges_m.size() % 2 == 1 ? count - 1 : count;
  scan.first_bearing_rad = -std::numbers::pi / 2;
  scan.bearing_step_rad = std::numbers::pi / std::max(intervals, 1.0);
  return Checked(std::move(scan), line);
}

// ROBOTLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy
// remission_mode n r_1 .. r_n m remission_1 .. remission_m laser_x laser_y laser_theta robot_x
// robot_y robot_theta laser_tv laser_rv forward_safety side_safety turn_axis ipc_time host
// logger_time
std::optional<CarmenScan> ParseRobotLaser(std::string_view text) {
  LineReader line(text);
  line.Word();
  line.Word();
  CarmenScan scan;
  scan.first_bearing_rad = line.Number();
  line.Number();
  scan.bearing_step_rad = line.Number();
  for (int k = 0; k < 3; ++k) line.Number();
  scan.ranges_m = line.Numbers();
  line.Numbers();
  scan.world_T_laser = line.Pose();
  line.Pose();
  for (int k = 0; k < 6; ++k) line.Number();
  line.Word();
  scan.time_s = line.Number();
  return Checked(std::move(scan), line);
}

}  // namespace

absl::StatusOr<CarmenLog> ReadCarmenLog(const std::string& path,
                                        absl::FunctionRef<void(double)> progress) {
  SPLINEMAP_ASSIGN_OR_RETURN(GzFile file, GzFile::Open(path));
  CarmenLog flaser;
  CarmenLog robot_laser;
  std::string line;
  int64_t line_number = 0;
  while (file.ReadLine(line)) {
    if (++line_number % 256 == 1) progress(file.ShareRead());
    CarmenLog* log = line.starts_with("FLASER ")        ? &flaser
                     : line.starts_with("ROBOTLASER1 ") ? &robot_laser
                                                        : nullptr;
    if (log == nullptr) continue;
    std::optional<CarmenScan> scan = log == &flaser ? ParseFlaser(line) : ParseRobotLaser(line);
    if (scan) {
      log->scans.push_back(*std::move(scan));
    } else if (log->broken_lines++ == 0) {
      log->first_broken_line = line_number;
    }
  }
  CarmenLog& log = flaser.scans.empty() ? robot_laser : flaser;
  log.ends_early = !file.status().ok();
  if (log.scans.empty()) {
    return InvalidArgument("{} has no FLASER or ROBOTLASER1 line that can be read in {} lines",
                           path, line_number);
  }
  progress(1);
  return std::move(log);
}

RepairedTimes RepairTimes(const std::vector<CarmenScan>& scans, double rate_hz) {
  RepairedTimes repaired;
  const Utime substitute(std::max<int64_t>(1, std::llround(1e6 / rate_hz)));
  for (size_t k = 0; k < scans.size(); ++k) {
    const double time_s = scans[k].time_s;
    if (k == 0) {
      const bool plausible = time_s > 0 && time_s < kMaxSeconds;
      repaired.utimes.emplace_back(plausible ? std::llround(time_s * 1e6) : 0);
      continue;
    }
    const double step_s = time_s - scans[k - 1].time_s;
    const bool plausible = step_s >= 1e-6 && step_s <= kMaxStepSeconds;
    if (!plausible) ++repaired.replaced;
    repaired.utimes.push_back(repaired.utimes.back() +
                              (plausible ? Utime(std::llround(step_s * 1e6)) : substitute));
  }
  return repaired;
}

}  // namespace splinemap
