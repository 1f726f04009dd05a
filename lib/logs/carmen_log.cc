#include "lib/logs/carmen_log.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <string_view>
#include <utility>

#include "absl/strings/numbers.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/logs/gz_file.h"
#include "lib/logs/lcm_log.h"
#include "lib/wire/encode.h"

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
    const size_t begin = rest_.find_first_not_of(kSpace);
    if (begin == std::string_view::npos) {
      ok_ = false;
      return {};
    }
    const size_t end = std::min(rest_.find_first_of(kSpace, begin), rest_.size());
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

  bool HasMore() const { return rest_.find_first_not_of(kSpace) != std::string_view::npos; }
  bool ok() const { return ok_; }

 private:
  static constexpr std::string_view kSpace = " \t\r\n";

  std::string_view rest_;
  bool ok_ = true;
};

double Degrees(double degrees) { return degrees * std::numbers::pi / 180; }

// ipc_time, host and logger_time at the end of a line, of which some may be missing: 0.
struct Times {
  explicit Times(LineReader& line) {
    if (line.HasMore()) ipc_s = line.Number();
    if (line.HasMore()) line.Word();
    if (line.HasMore()) logger_s = line.Number();
  }

  double ipc_s = 0;
  double logger_s = 0;
};

// A line that was read, and what is to be done with it when the whole log is known.
struct Line {
  CarmenScan scan;
  Times times;
  double max_range_m = 0;  // at which nothing was hit; 0: not told
};

bool IsUsable(const CarmenScan& scan, const LineReader& line) {
  return line.ok() && !scan.ranges_m.empty() && scan.world_T_laser.position_m.allFinite() &&
         std::isfinite(scan.world_T_laser.yaw_rad) && std::isfinite(scan.first_bearing_rad) &&
         std::isfinite(scan.bearing_step_rad);
}

// FLASER n r_1 .. r_n x y theta odom_x odom_y odom_theta ipc_time host logger_time
std::optional<Line> ParseFlaser(LineReader& line) {
  CarmenScan scan;
  scan.ranges_m = line.Numbers();
  scan.world_T_laser = line.Pose();
  line.Pose();  // odometry
  const Times times(line);
  if (!IsUsable(scan, line)) return std::nullopt;
  return Line{std::move(scan), times};
}

// RAWLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy
// remission_mode n r_1 .. r_n m remission_1 .. remission_m ipc_time host logger_time.
// ROBOTLASER1 has laser_x laser_y laser_theta robot_x robot_y robot_theta laser_tv laser_rv
// forward_safety side_safety turn_axis before the times.
std::optional<Line> ParseLaser(LineReader& line, bool has_pose) {
  CarmenScan scan;
  line.Word();
  scan.first_bearing_rad = line.Number();
  line.Number();
  scan.bearing_step_rad = line.Number();
  const double max_range_m = line.Number();
  for (int k = 0; k < 2; ++k) line.Number();
  scan.ranges_m = line.Numbers();
  line.Numbers();
  if (has_pose) {
    scan.world_T_laser = line.Pose();
    line.Pose();
    for (int k = 0; k < 5; ++k) line.Number();
  }
  const Times times(line);
  if (!IsUsable(scan, line)) return std::nullopt;
  return Line{std::move(scan), times, max_range_m};
}

// The field of view of n readings where the format does not say it, first bearing and step.
struct FieldOfView {
  double first_bearing_rad = 0;
  double step_rad = 0;
};

// Around the x axis, with a beam at the end of it where their number is odd, as scanners have that
// measure at whole steps of a half or a quarter turn.
FieldOfView Spread(size_t readings, double field_of_view_rad) {
  const auto count = static_cast<double>(readings);
  const double intervals = readings % 2 == 1 ? count - 1 : count;
  return {-field_of_view_rad / 2, field_of_view_rad / std::max(intervals, 1.0)};
}

// By the number of their readings: scanners that look elsewhere than over half a turn. SICK LMS in
// its mode of 100 degrees; Hokuyo URG-04LX, UST and UTM-30LX.
std::optional<double> KnownFieldOfView(size_t readings) {
  switch (readings) {
    case 401:
      return Degrees(100);
    case 682:
      return Degrees(682 * 360.0 / 1024);
    case 541:
    case 1081:
      return Degrees(270);
    default:
      return std::nullopt;
  }
}

// What PARAM lines say of the front laser.
struct Parameters {
  std::optional<double> field_of_view;  // degrees, in old logs rad
  std::optional<double> resolution_deg;
  std::optional<double> max_range_m;

  void Read(LineReader& line) {
    const std::string_view name = line.Word();
    std::optional<double>* const value = name == "laser_front_laser_fov"          ? &field_of_view
                                         : name == "laser_front_laser_resolution" ? &resolution_deg
                                         : name == "robot_front_laser_max"        ? &max_range_m
                                                                                  : nullptr;
    if (value == nullptr) return;
    const double number = line.Number();
    if (line.ok() && number > 0 && std::isfinite(number)) *value = number;
  }

  std::optional<double> FieldOfViewRad(size_t readings) const {
    if (field_of_view) {
      const bool is_rad = *field_of_view <= 2 * std::numbers::pi + 0.01;
      const double degrees = is_rad ? *field_of_view * 180 / std::numbers::pi : *field_of_view;
      if (degrees > 361) return std::nullopt;
      // They are rounded: half a turn is half a turn.
      return Degrees(std::abs(degrees - std::round(degrees)) < 0.01 ? std::round(degrees)
                                                                    : degrees);
    }
    if (!resolution_deg) return std::nullopt;
    const auto count = static_cast<double>(readings);
    const double degrees = *resolution_deg * (readings % 2 == 1 ? count - 1 : count);
    if (degrees > 361) return std::nullopt;
    return Degrees(degrees);
  }
};

struct Odometry {
  Pose2 pose;
  Times times;
  size_t num_scans_before = 0;  // in the file
};

// ODOM x y theta tv rv accel ipc_time host logger_time
std::optional<Odometry> ParseOdometry(LineReader& line, size_t num_scans_before) {
  const Pose2 pose = line.Pose();
  for (int k = 0; k < 3; ++k) line.Number();
  const Odometry odometry{pose, Times(line), num_scans_before};
  if (!line.ok() || !odometry.pose.position_m.allFinite() || !std::isfinite(odometry.pose.yaw_rad))
    return std::nullopt;
  return odometry;
}

// Everything of a log, before it is clear which lines count.
struct Contents {
  struct Scans {
    std::vector<Line> lines;
    int64_t broken = 0;
    int64_t first_broken = 0;
  };
  Scans flaser;
  Scans robot_laser;
  Scans raw_laser;
  std::vector<Odometry> odometry;  // with the RAWLASER1 lines before each
  Parameters parameters;
  int64_t first_gmapping_line = 0;

  void Read(std::string_view text, int64_t line_number) {
    LineReader line(text);
    if (!line.HasMore()) return;
    const std::string_view kind = line.Word();
    if (kind == "PARAM") parameters.Read(line);
    if (kind == "LASER_READING" || kind == "SM_UPDATE") {
      if (first_gmapping_line == 0) first_gmapping_line = line_number;
    }
    if (kind == "ODOM") {
      const auto read = ParseOdometry(line, raw_laser.lines.size());
      if (read) odometry.push_back(*read);
    }
    if (kind == "FLASER") Add(flaser, ParseFlaser(line), line_number);
    if (kind == "ROBOTLASER1") Add(robot_laser, ParseLaser(line, true), line_number);
    if (kind == "RAWLASER1") Add(raw_laser, ParseLaser(line, false), line_number);
  }

 private:
  static void Add(Scans& scans, std::optional<Line> line, int64_t line_number) {
    if (line) {
      scans.lines.push_back(*std::move(line));
    } else if (scans.broken++ == 0) {
      scans.first_broken = line_number;
    }
  }
};

void SetFieldOfView(const Parameters& parameters, std::optional<double> given, CarmenLog& log) {
  for (CarmenScan& scan : log.scans) {
    const size_t readings = scan.ranges_m.size();
    std::optional<double> angle = given;
    if (!angle) angle = parameters.FieldOfViewRad(readings);
    if (!angle) angle = KnownFieldOfView(readings);
    log.field_of_view_is_guessed |= !angle;
    log.field_of_view_rad = angle.value_or(std::numbers::pi);
    const FieldOfView view = Spread(readings, log.field_of_view_rad);
    scan.first_bearing_rad = view.first_bearing_rad;
    scan.bearing_step_rad = view.step_rad;
  }
}

// The clock that counts on better: that of the logger, or the other one where it was not set.
double Times::*ChooseClock(const std::vector<Line>& lines) {
  const auto num_steps = [&](double Times::*clock) {
    return std::count_if(lines.begin(), lines.end(), [&, last = 0.0](const Line& line) mutable {
      const double step_s = line.times.*clock - std::exchange(last, line.times.*clock);
      return step_s > 0 && step_s <= kMaxStepSeconds;
    });
  };
  return num_steps(&Times::logger_s) >= num_steps(&Times::ipc_s) ? &Times::logger_s : &Times::ipc_s;
}

// The poses of the ODOM lines before and after each scan, at its time where the three times are in
// order, and else that of the line before.
void PlaceByOdometry(const std::vector<Odometry>& odometry, double Times::*clock, CarmenLog& log) {
  std::vector<CarmenScan> placed;
  size_t next = 0;  // ODOM line behind the scan
  for (size_t k = 0; k < log.scans.size(); ++k) {
    while (next < odometry.size() && odometry[next].num_scans_before <= k) ++next;
    if (next == 0) continue;
    const Odometry& before = odometry[next - 1];
    CarmenScan& scan = log.scans[k];
    scan.world_T_laser = before.pose;
    if (next < odometry.size()) {
      const Odometry& after = odometry[next];
      const double span_s = after.times.*clock - before.times.*clock;
      const double fraction = (scan.time_s - before.times.*clock) / span_s;
      if (span_s > 0 && fraction >= 0 && fraction <= 1) {
        scan.world_T_laser = Interpolate(before.pose, after.pose, fraction);
      }
    }
    placed.push_back(std::move(scan));
  }
  log.scans_without_pose = std::ssize(log.scans) - std::ssize(placed);
  log.scans = std::move(placed);
}

absl::Status WhyWithoutScans(const std::string& path, const Contents& contents, int64_t lines) {
  if (contents.first_gmapping_line > 0) {
    return InvalidArgument(
        "{} is a log of GMapping (.gfs), by its line {}: its program gfs2log makes a CARMEN log of "
        "it",
        path, contents.first_gmapping_line);
  }
  if (!contents.raw_laser.lines.empty()) {
    return InvalidArgument(
        "{} has {} RAWLASER1 lines and no ODOM line before them, so nothing says where the scans "
        "were taken",
        path, contents.raw_laser.lines.size());
  }
  for (const auto& [kind, scans] :
       {std::pair("FLASER", &contents.flaser), std::pair("ROBOTLASER1", &contents.robot_laser),
        std::pair("RAWLASER1", &contents.raw_laser)}) {
    if (scans->broken == 0) continue;
    return InvalidArgument("none of the {} {} lines of {} can be read, the first is line {}",
                           scans->broken, kind, path, scans->first_broken);
  }
  return InvalidArgument("{} has no FLASER, ROBOTLASER1 or RAWLASER1 line in {} lines", path,
                         lines);
}

}  // namespace

absl::StatusOr<CarmenLog> ReadCarmenLog(const std::string& path,
                                        std::optional<double> field_of_view_rad,
                                        absl::FunctionRef<void(double)> progress) {
  SPLINEMAP_ASSIGN_OR_RETURN(GzFile file, GzFile::Open(path));
  Contents contents;
  std::string text;
  int64_t line_number = 0;
  while (file.ReadLine(text)) {
    if (++line_number % 256 == 1) progress(file.ShareRead());
    if (line_number == 1) text = std::string(WithoutByteOrderMark(text));
    contents.Read(text, line_number);
  }
  const bool is_flaser = contents.flaser.lines.size() >= contents.robot_laser.lines.size() &&
                         !contents.flaser.lines.empty();
  const bool is_raw = !is_flaser && contents.robot_laser.lines.empty();
  Contents::Scans& scans = is_flaser ? contents.flaser
                           : is_raw  ? contents.raw_laser
                                     : contents.robot_laser;
  CarmenLog log;
  log.kind = is_flaser ? "FLASER" : is_raw ? "RAWLASER1" : "ROBOTLASER1";
  log.ends_early = !file.status().ok();
  log.broken_lines = scans.broken;
  log.first_broken_line = scans.first_broken;
  if (!is_raw) {
    log.other_scans = std::ssize(is_flaser ? contents.robot_laser.lines : contents.flaser.lines);
  }
  double Times::*const clock = ChooseClock(scans.lines);
  for (Line& line : scans.lines) {
    line.scan.time_s = line.times.*clock;
    const double max_m = is_flaser ? contents.parameters.max_range_m.value_or(0) : line.max_range_m;
    for (float& range_m : line.scan.ranges_m) {
      if (max_m > 0 && range_m >= max_m) range_m = std::numeric_limits<float>::infinity();
    }
    log.scans.push_back(std::move(line.scan));
  }
  if (is_flaser) SetFieldOfView(contents.parameters, field_of_view_rad, log);
  if (is_raw) PlaceByOdometry(contents.odometry, clock, log);
  if (log.scans.empty()) return WhyWithoutScans(path, contents, line_number);
  progress(1);
  return log;
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

absl::Status WriteAsLcmLog(const CarmenLog& log, const std::vector<Utime>& utimes,
                           const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(LcmLogWriter writer, LcmLogWriter::Create(path));
  for (size_t k = 0; k < log.scans.size(); ++k) {
    const CarmenScan& scan = log.scans[k];
    const Utime utime = utimes[k];
    SPLINEMAP_RETURN_IF_ERROR(
        writer.Write(utime, "POSE", PoseMessage({utime, scan.world_T_laser})));
    SPLINEMAP_RETURN_IF_ERROR(writer.Write(
        utime, "LASER",
        PlanarLidarMessage(utime, scan.ranges_m, scan.first_bearing_rad, scan.bearing_step_rad)));
  }
  return writer.Close();
}

}  // namespace splinemap
