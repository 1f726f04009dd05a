#include <CLI/App.hpp>
#include <cstdio>
#include <limits>
#include <memory>
#include <string>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "lib/base/status.h"
#include "lib/logs/trajectory_file.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

struct CorrectFlags {
  std::string map, trajectory, layer;
  Output output;
  double rate_hz = 10;
  bool accepts_corrupt = false;
};

absl::StatusOr<int> Correct(const CorrectFlags& flags) {
  if (flags.output.path.empty()) return InvalidArgument("give the map file to write with --out");
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map, flags.trajectory}));
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadInput(flags.map, flags.accepts_corrupt));
  if (loaded.set.layers.size() != 1 && flags.layer.empty()) {
    return InvalidArgument("{} has {} layers; say which one is to be corrected with --layer",
                           flags.map, loaded.set.layers.size());
  }
  Trajectory trajectory;
  SPLINEMAP_ASSIGN_OR_RETURN(trajectory.poses, ReadTrajectory(flags.trajectory, flags.rate_hz));
  trajectory.until = Utime::max();
  SPLINEMAP_RETURN_IF_ERROR(CheckTrajectory(trajectory));
  std::vector<std::string> names;
  if (!flags.layer.empty()) names.push_back(flags.layer);
  int64_t moved = 0;
  SPLINEMAP_RETURN_IF_ERROR(Refold(loaded.set, names, [&](const ScanArchive& archive) {
    absl::StatusOr<ArchiveEdit> edit = CorrectBy(archive, trajectory);
    if (edit.ok()) {
      archive.ForEachPose([&](const ScanPose& pose) {
        if (edit->move(pose) != pose.world_T_robot) ++moved;
      });
    }
    return edit;
  }));
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.path));
  PrintLine(stderr, "moved {} scans to {} poses; {}", moved, trajectory.poses.size(),
            flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

constexpr const char* kCorrectExamples = R"(
Examples:
  splinemap correct drive.splinemap trajectory.csv --out corrected.splinemap
  splinemap correct odometry.splinemap intel.log.gz --out corrected.splinemap

A scan at the time of a pose of the trajectory gets that pose; scans between two poses move with
both, those after the last with that one, and those before the first stay. The trajectory is a CSV
file of lines utime,x_m,y_m,yaw_rad (us, on the clock of the scans), or a corrected CARMEN log, whose
stamps are those that import-carmen gives.)";

}  // namespace

void AddCorrect(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<CorrectFlags>();
  CLI::App* command = app.add_subcommand("correct", "Move the scans of a map to better poses");
  command->footer(kCorrectExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("TRAJECTORY", flags->trajectory, "CSV file or CARMEN log")->required();
  AddOutOption(*command, "Map file to write", flags->output);
  command->add_option("--layer", flags->layer, "The layer to correct, where there are several")
      ->type_name("NAME");
  command
      ->add_option("--rate", flags->rate_hz,
                   "Hz, scans of a CARMEN log whose time stamps are useless (default 10)")
      ->check(CLI::Range(0.001, 1000.0));
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return Correct(*flags); }; });
}

}  // namespace splinemap
