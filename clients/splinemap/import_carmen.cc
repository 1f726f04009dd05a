#include <CLI/App.hpp>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <optional>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/status.h"
#include "lib/logs/carmen_log.h"

namespace splinemap {
namespace {

struct ImportCarmenFlags {
  std::string log;
  Output output;
  double rate_hz = 10;
  double field_of_view_deg = 0;  // 0: as the log says
};

absl::StatusOr<int> ImportCarmen(const ImportCarmenFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.output, {flags.log}));
  CarmenLog log;
  {
    ProgressBar bar("reading");
    std::optional<double> field_of_view_rad;
    if (flags.field_of_view_deg > 0)
      field_of_view_rad = flags.field_of_view_deg * std::numbers::pi / 180;
    SPLINEMAP_ASSIGN_OR_RETURN(
        log, ReadCarmenLog(flags.log, field_of_view_rad, [&](double share) { bar.Show(share); }));
  }
  const RepairedTimes times = RepairTimes(log.scans, flags.rate_hz);
  SPLINEMAP_RETURN_IF_ERROR(WriteAsLcmLog(log, times.utimes, flags.output.path));

  PrintLine(stderr, "{} scans and poses written to {}, from {} lines", log.scans.size(),
            flags.output.path, log.kind);
  if (log.kind == "RAWLASER1") {
    PrintLine(stderr,
              "the poses are the robot's odometry, which drifts: the log has no corrected poses");
  }
  if (log.field_of_view_is_guessed) {
    PrintLine(stderr,
              "FLASER lines do not say the field of view; {} degrees are assumed for scans of {} "
              "readings. If walls come out double: --fov-deg",
              std::lround(log.field_of_view_rad * 180 / std::numbers::pi),
              log.scans[0].ranges_m.size());
  }
  if (log.other_scans > 0) {
    PrintLine(stderr, "{} {} lines were left out, which are fewer", log.other_scans,
              log.kind == "FLASER" ? "ROBOTLASER1" : "FLASER");
  }
  if (log.scans_without_pose > 0) {
    PrintLine(stderr, "{} RAWLASER1 lines come before the first ODOM line and were left out",
              log.scans_without_pose);
  }
  if (times.replaced > 0) {
    PrintLine(stderr,
              "{} scans have time stamps that repeat, step back or jump; these scans are stamped "
              "1/{:g} s apart, which --rate changes",
              times.replaced, flags.rate_hz);
  }
  if (log.broken_lines > 0) {
    PrintLine(stderr, "{} lines could not be read and were skipped, the first is line {}",
              log.broken_lines, log.first_broken_line);
  }
  if (log.ends_early) {
    return DataLoss("{} is cut off or corrupt; {} has what precedes", flags.log, flags.output.path);
  }
  return kSuccess;
}

constexpr const char* kImportCarmenExamples = R"(
Examples:
  splinemap import-carmen intel.log.gz intel.lcmlog
  splinemap build intel.lcmlog intel.splinemap
  splinemap import-carmen --fov-deg 360 turret.log turret.lcmlog

Writes the channels LASER (bot_core.planar_lidar_t) and POSE (bot_core.pose_t), the pose of the
laser in the log. Reads FLASER or ROBOTLASER1 lines, whichever are more, or else RAWLASER1 lines
with the poses of ODOM lines.)";

}  // namespace

void AddImportCarmen(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<ImportCarmenFlags>();
  CLI::App* command = app.add_subcommand("import-carmen", "Convert a CARMEN log to an LCM log");
  command->footer(kImportCarmenExamples);
  command->add_option("LOG", flags->log, "CARMEN log, plain or gzip")->required();
  AddOutput(*command, "OUT", "LCM log to write", flags->output);
  command
      ->add_option("--rate", flags->rate_hz, "Hz, scans whose time stamps are useless (default 10)")
      ->check(CLI::Range(0.001, 1000.0));
  command
      ->add_option("--fov-deg", flags->field_of_view_deg,
                   "Field of view of FLASER lines (default: what PARAM lines say, what scanners "
                   "with so many readings have, or 180)")
      ->check(CLI::Range(1.0, 360.0));
  command->callback([flags, &chosen] { chosen = [flags] { return ImportCarmen(*flags); }; });
}

}  // namespace splinemap
