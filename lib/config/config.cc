#include "lib/config/config.h"

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <numbers>
#include <set>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/config/checked_text.h"

namespace splinemap {
namespace {

// Facts behind the presets:
// michigan_2014: the lidar turns clockwise; utime is that of the first beam, beam times are true.
// michigan_2017: clockwise; utime is taken when the whole scan has arrived, beam times are useless.
// mbot_2024: bearings are turned counter-clockwise by reversing the list, so the first beam listed
// is the newest; utime is taken when the scan has arrived, beam times run against the list.
const std::vector<std::pair<std::string, std::string>>& Presets() {
  static const auto* presets = new std::vector<std::pair<std::string, std::string>>{
      {"bot_core", ""},
      {"michigan_2014", "bearing_sign: -1 beam_times: true"},
      {"michigan_2017", "bearing_sign: -1 time_offset_ms: -150 scan_duration_ms: 100"},
      {"mbot_2024", "bearing_sign: 1 scan_duration_ms: -100"},
  };
  return *presets;
}

constexpr size_t kMaxChannelLength = 63;  // LCM_MAX_CHANNEL_NAME_LENGTH

bool IsNameCharacter(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) || c == '.' || c == '_' || c == '-';
}

double Radians(double degrees) { return degrees * std::numbers::pi / 180; }

// FROM..TO in degrees.
absl::StatusOr<BearingRange> ParseMask(const std::string& text) {
  const std::vector<std::string> ends = absl::StrSplit(text, "..");
  double from_deg = 0;
  double to_deg = 0;
  const bool is_range = ends.size() == 2 && absl::SimpleAtod(ends[0], &from_deg) &&
                        absl::SimpleAtod(ends[1], &to_deg) && std::abs(from_deg) <= 360 &&
                        std::abs(to_deg) <= 360 && std::fmod(to_deg - from_deg, 360) != 0;
  if (!is_range) {
    return InvalidArgument("mask {} is not FROM..TO in degrees within -360 .. 360, as in 170..-170",
                           text);
  }
  const double span_deg = std::fmod(to_deg - from_deg + 720, 360);
  return BearingRange{Radians(from_deg), Radians(span_deg)};
}

Utime Milliseconds(double value) { return Utime(std::llround(value * 1000)); }

config::Method WithPreset(const config::Method& method) {
  config::Method merged;
  if (method.preset() == "paper") {
    merged.set_clamp_min(-100);
    merged.set_clamp_max(100);
    merged.set_kappa_free(-0.3);
    merged.set_update("paper_samples");
  }
  merged.MergeFrom(method);
  return merged;
}

ControlPoint ToControlPoint(double log_odds) {
  return static_cast<ControlPoint>(std::lround(log_odds * kUnitsPerLogOdds));
}

absl::Status CheckScan(const config::Scan& scan, double knot_interval_m) {
  if (scan.channel().empty()) return InvalidArgument("a scan without a channel");
  if (std::max(scan.channel().size(), scan.extrinsics_channel().size()) > kMaxChannelLength) {
    return InvalidArgument("scan {}: LCM's channels have {} bytes at most", scan.channel(),
                           kMaxChannelLength);
  }
  if (scan.range_min_m() >= scan.range_max_m()) {
    return InvalidArgument("scan {}: range_min_m {} is not below range_max_m {}", scan.channel(),
                           scan.range_min_m(), scan.range_max_m());
  }
  for (const std::string& mask : scan.mask()) {
    if (const auto range = ParseMask(mask); !range.ok()) {
      return InvalidArgument("scan {}: {}", scan.channel(), ErrorText(range.status()));
    }
  }
  const double knots = scan.range_max_m() / knot_interval_m;
  if (scan.has_extrinsics_channel() && scan.extrinsics_channel().empty()) {
    return InvalidArgument("scan {}: extrinsics_channel is empty", scan.channel());
  }
  if (scan.has_extrinsics_channel() && (scan.has_x_m() || scan.has_y_m() || scan.has_yaw_deg())) {
    return InvalidArgument("scan {}: either extrinsics_channel or x_m, y_m and yaw_deg",
                           scan.channel());
  }
  if (knots > 4096) {
    return InvalidArgument(
        "scan {}: range_max_m {} is {:.0f} knot intervals of {} m; 4096 are the most",
        scan.channel(), scan.range_max_m(), knots, knot_interval_m);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<config::Config> LoadConfig(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  config::Config config;
  SPLINEMAP_RETURN_IF_ERROR(ParseCheckedText(text, path, &config));
  return config;
}

absl::StatusOr<config::Scan> ParseScanFlag(const std::string& flag) {
  config::Scan scan;
  const size_t end = flag.find_first_of(":,");
  scan.set_channel(flag.substr(0, end));
  if (scan.channel().empty() || scan.channel().starts_with('-')) {
    return InvalidArgument(
        "--scan {}: no channel; it goes as --scan CHANNEL[:PRESET][,OPTION=VALUE]", flag);
  }
  if (end == std::string::npos) return scan;
  bool is_first = flag[end] == ':';
  const std::vector<std::string> parts = absl::StrSplit(flag.substr(end + 1), ',');
  for (const std::string& part : parts) {
    const size_t equals = part.find('=');
    const bool is_preset = is_first && equals == std::string::npos;
    is_first = false;
    if (!is_preset && equals == std::string::npos) {
      return InvalidArgument("--scan {}: {} is no option=value", flag, part);
    }
    const absl::Status status =
        is_preset ? SetCheckedField("preset", part, &scan)
                  : SetCheckedField(part.substr(0, equals), part.substr(equals + 1), &scan);
    if (!status.ok()) return InvalidArgument("--scan {}: {}", flag, ErrorText(status));
  }
  return scan;
}

std::string ScanFlagOf(const config::Scan& scan) {
  std::string flag = scan.channel();
  if (scan.has_preset()) flag += ":" + scan.preset();
  config::Scan options = scan;
  options.clear_channel();
  options.clear_preset();
  for (const auto& [name, value] : SetFields(options)) flag += fmt::format(",{}={}", name, value);
  return flag;
}

absl::Status CheckConfig(const config::Config& config) {
  if (config.service().forget_after_min() > 0 && config.service().max_archive_mb() == 0) {
    return InvalidArgument(
        "forget_after_min is set and max_archive_mb is 0; what is to be forgotten has to be kept");
  }
  if (!config.frame().empty()) SPLINEMAP_RETURN_IF_ERROR(ParseFrame(config.frame()).status());
  const bool has_sensors = config.scan_size() > 0 || !config.pose().empty();
  if (!config.service().sensors() && has_sensors) {
    return InvalidArgument(
        "scan or pose channels, and service {{ sensors: false }} (--no-sensors), which is for a "
        "base station that has none");
  }
  if (config.service().sensors() && (config.scan_size() == 0 || config.pose().empty())) {
    return InvalidArgument(
        "no {} channel: give --scan CHANNEL[:PRESET] and --pose CHANNEL, or scan {{ channel: .. }} "
        "and pose: in a file for --config. What is on the bus shows: splinemap doctor --live; in a "
        "log: "
        "splinemap doctor LOG",
        config.scan_size() == 0 ? "scan" : "pose");
  }
  // The longest are those of replies, _REPLIES_ and 16 digits.
  if (std::max(config.channel_prefix().size() + 25, config.pose().size()) > kMaxChannelLength) {
    return InvalidArgument(
        "channel_prefix or pose is too long; LCM's channels have {} bytes at most",
        kMaxChannelLength);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckRobotName(RobotName(config)));
  std::set<std::string> channels{config.pose()};
  for (const config::Scan& scan : config.scan()) {
    if (!channels.insert(scan.channel()).second) {
      return InvalidArgument("channel {} is named twice", scan.channel());
    }
    SPLINEMAP_RETURN_IF_ERROR(CheckScan(scan, config.method().knot_interval_m()));
  }
  // One transform may serve two scan channels.
  for (const config::Scan& scan : config.scan()) {
    if (channels.contains(scan.extrinsics_channel())) {
      return InvalidArgument("extrinsics_channel {} of scan {} is a channel of scans or poses",
                             scan.extrinsics_channel(), scan.channel());
    }
  }
  return absl::OkStatus();
}

std::vector<std::string> PresetNames() {
  std::vector<std::string> names;
  for (const auto& [name, text] : Presets()) names.push_back(name);
  return names;
}

std::optional<std::string> DetectPreset(bool is_planar_lidar, const RangeReadings& first_message) {
  if (is_planar_lidar) return "bot_core";
  const std::vector<Utime>& times = first_message.beam_utimes;
  if (times.size() < 2) return std::nullopt;
  if (!HaveUsefulBeamTimes(first_message)) return "michigan_2017";
  const Utime to_first = std::chrono::abs(times.front() - first_message.utime);
  const Utime to_last = std::chrono::abs(times.back() - first_message.utime);
  return to_first <= to_last ? "michigan_2014" : "mbot_2024";
}

SensorOptions SensorOptionsOf(const config::Scan& scan, const std::string& preset) {
  config::Scan merged;
  for (const auto& [name, text] : Presets()) {
    if (name == preset) ParseCheckedText(text, name, &merged).IgnoreError();  // tested
  }
  merged.MergeFrom(scan);
  SensorOptions options;
  options.bearing_sign = merged.bearing_sign();
  options.field_of_view_rad = Radians(merged.fov_deg());
  options.stamp_is_receipt = merged.stamp() == "receive";
  options.time_offset = Milliseconds(merged.time_offset_ms());
  options.scan_duration = Milliseconds(merged.scan_duration_ms());
  options.use_beam_times = merged.beam_times();
  options.range_min_m = merged.range_min_m();
  options.range_max_m = merged.range_max_m();
  options.no_return_is_free = merged.no_return() == "free";
  options.no_return_up_to_m = merged.no_return_up_to_m();
  for (const std::string& mask : merged.mask()) {
    options.masks.push_back(ParseMask(mask).value_or(BearingRange{}));  // CheckConfig() saw them
  }
  options.every_nth_beam = static_cast<int>(merged.every_nth_beam());
  options.min_travel_m = merged.min_travel_m();
  options.min_turn_rad = Radians(merged.min_turn_deg());
  options.mount.robot_T_sensor = {{merged.x_m(), merged.y_m()}, Radians(merged.yaw_deg())};
  return options;
}

MapOptions MapOptionsOf(const config::Method& method) {
  const config::Method merged = WithPreset(method);
  return {merged.knot_interval_m(),
          {ToControlPoint(merged.clamp_min()), ToControlPoint(merged.clamp_max())}};
}

BeamModelOptions BeamModelOptionsOf(const config::Method& method) {
  const config::Method merged = WithPreset(method);
  return {.update = merged.update() == "paper_samples" ? BeamUpdate::kPaperSamples
                    : merged.update() == "paper_line"  ? BeamUpdate::kPaperLine
                                                       : BeamUpdate::kSignedDistance,
          .kappa_hit = merged.kappa_hit(),
          .kappa_free = merged.kappa_free(),
          .free_sample_spacing_knots = merged.free_sample_spacing_knots()};
}

ScanQueueOptions ScanQueueOptionsOf(const config::Timing& timing) {
  ScanQueueOptions options;
  options.max_pose_wait = Milliseconds(timing.max_pose_wait_ms());
  options.max_pose_gap = Milliseconds(timing.max_pose_gap_ms());
  options.max_order_wait = Milliseconds(timing.max_order_wait_ms());
  options.time_jump = Milliseconds(timing.time_jump_ms());
  options.pose_history = 2 * (options.max_pose_wait + options.max_pose_gap) +
                         options.max_order_wait + 2 * kMaxBeamTimeOffset + std::chrono::seconds(10);
  return options;
}

absl::Status CheckRobotName(const std::string& name) {
  if (!name.empty() && name.size() <= 64 &&
      std::all_of(name.begin(), name.end(), IsNameCharacter)) {
    return absl::OkStatus();
  }
  return InvalidArgument(
      "name {} is not made of up to 64 letters, digits and . _ -; give another with --name", name);
}

absl::StatusOr<FixedPose2> ParseFrame(const std::string& text) {
  constexpr double kMax_m = 1e7;
  const std::vector<std::string> words = absl::StrSplit(text, ',');
  double x_m = 0, y_m = 0, yaw_deg = 0;
  if (words.size() != 3 || !absl::SimpleAtod(words[0], &x_m) || !absl::SimpleAtod(words[1], &y_m) ||
      !absl::SimpleAtod(words[2], &yaw_deg) ||
      !(std::abs(x_m) <= kMax_m && std::abs(y_m) <= kMax_m && std::abs(yaw_deg) <= 360)) {
    return InvalidArgument("frame {}: X_M,Y_M,YAW_DEG is expected, as in 2.5,-1,90", text);
  }
  return FixedPose2::Nearest({{x_m, y_m}, yaw_deg * std::numbers::pi / 180});
}

FixedPose2 FrameOf(const config::Config& config) {
  return config.frame().empty() ? FixedPose2() : *ParseFrame(config.frame());
}

std::string RobotName(const config::Config& config) {
  if (!config.name().empty()) return config.name();
  char host[256] = "";
  gethostname(host, sizeof host - 1);
  return host[0] != '\0' ? host : "robot";
}

std::string MapPath(const config::Config& config) {
  return config.map().empty() ? RobotName(config) + ".splinemap" : config.map();
}

}  // namespace splinemap
