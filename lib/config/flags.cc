#include "lib/config/flags.h"

#include "absl/strings/str_join.h"
#include "lib/base/status.h"

namespace splinemap {

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
  if (!flags.frame.empty()) config.set_frame(flags.frame);
  if (!flags.scans.empty()) config.clear_scan();
  for (const std::string& flag : flags.scans) {
    SPLINEMAP_ASSIGN_OR_RETURN(*config.add_scan(), ParseScanFlag(flag));
  }
  return config;
}

}  // namespace splinemap
