#include "lib/config/flags.h"

#include <cmath>

#include "absl/strings/numbers.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "lib/base/status.h"

namespace splinemap {

namespace {

absl::StatusOr<config::Frame> ParseFrameFlag(const std::string& text) {
  constexpr double kMax_m = 1e7;
  const std::vector<std::string> words = absl::StrSplit(text, ',');
  double x_m = 0, y_m = 0, yaw_deg = 0;
  if (words.size() != 3 || !absl::SimpleAtod(words[0], &x_m) || !absl::SimpleAtod(words[1], &y_m) ||
      !absl::SimpleAtod(words[2], &yaw_deg) ||
      !(std::abs(x_m) <= kMax_m && std::abs(y_m) <= kMax_m && std::abs(yaw_deg) <= 360)) {
    return InvalidArgument("--frame {}: X_M,Y_M,YAW_DEG is expected, as in 2.5,-1,90", text);
  }
  config::Frame frame;
  frame.set_x_m(x_m);
  frame.set_y_m(y_m);
  frame.set_yaw_deg(yaw_deg);
  return frame;
}

}  // namespace

void AddInputFlags(CLI::App& app, InputFlags& flags) {
  app.add_option(
         "--scan", flags.scans,
         "Scan channel with how to read it; more than once for several; replaces all of "
         "--config. Presets: auto, " +
             absl::StrJoin(PresetNames(), ", ") +
             ". Options: bearing_sign, fov_deg, stamp, time_offset_ms, scan_duration_ms, "
             "beam_times, "
             "range_min_m, range_max_m, no_return, no_return_up_to_m, mask, every_nth_beam, "
             "min_travel_m, min_turn_deg, x_m, y_m, yaw_deg, extrinsics_channel")
      ->type_name("CHANNEL[:PRESET][,OPTION=VALUE]...")
      ->allow_extra_args(false);  // what follows may be a file
  app.add_option("--pose", flags.pose, "Channel of the robot's poses")->type_name("CHANNEL");
  app.add_option("--name", flags.name, "Name of the robot (default: name of the host)");
  app.add_option("--frame", flags.frame,
                 "From the frame of the poses to that of the map (default 0,0,0)")
      ->type_name("X_M,Y_M,YAW_DEG");
  app.add_option("--config", flags.config_path,
                 "Configuration in Protobuf text format; splinemapd --print-config shows one")
      ->type_name("FILE");
}

absl::StatusOr<config::Config> ConfigOf(const InputFlags& flags) {
  config::Config config;
  if (!flags.config_path.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(config, LoadConfig(flags.config_path));
  }
  if (!flags.pose.empty()) config.set_pose(flags.pose);
  if (!flags.name.empty()) config.set_name(flags.name);
  if (!flags.frame.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(*config.mutable_frame(), ParseFrameFlag(flags.frame));
  }
  if (!flags.scans.empty()) config.clear_scan();
  for (const std::string& flag : flags.scans) {
    SPLINEMAP_ASSIGN_OR_RETURN(*config.add_scan(), ParseScanFlag(flag));
  }
  return config;
}

}  // namespace splinemap
