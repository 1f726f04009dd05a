#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/progress.h"
#include "clients/splinemap/say.h"
#include "lib/base/status.h"
#include "lib/logs/carmen_log.h"
#include "lib/logs/lcm_log.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

struct ImportCarmenFlags {
  bool force = false;
  std::string in;
  std::string out;
  double rate_hz = 10;
};

absl::StatusOr<int> ImportCarmen(const ImportCarmenFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.out, flags.force));
  CarmenLog log;
  {
    ProgressBar bar("reading");
    SPLINEMAP_ASSIGN_OR_RETURN(log,
                               ReadCarmenLog(flags.in, [&](double share) { bar.Show(share); }));
  }
  const RepairedTimes times = RepairTimes(log.scans, flags.rate_hz);
  SPLINEMAP_ASSIGN_OR_RETURN(LcmLogWriter writer, LcmLogWriter::Create(flags.out));
  for (size_t k = 0; k < log.scans.size(); ++k) {
    const CarmenScan& scan = log.scans[k];
    const Utime utime = times.utimes[k];
    SPLINEMAP_RETURN_IF_ERROR(
        writer.Write(utime, "POSE", PoseMessage({utime, scan.world_T_laser})));
    SPLINEMAP_RETURN_IF_ERROR(writer.Write(
        utime, "LASER",
        PlanarLidarMessage(utime, scan.ranges_m, scan.first_bearing_rad, scan.bearing_step_rad)));
  }
  SPLINEMAP_RETURN_IF_ERROR(writer.Close());

  Say(stderr, "{} scans and poses written to {}", log.scans.size(), flags.out);
  if (times.replaced > 0) {
    Say(stderr,
        "{} time stamps stood still, went back or jumped and were replaced by steps of 1/{:g} s "
        "(--rate)",
        times.replaced, flags.rate_hz);
  }
  if (log.broken_lines > 0) {
    Say(stderr, "{} lines could not be read and were skipped, the first is line {}",
        log.broken_lines, log.first_broken_line);
  }
  if (log.ends_early) {
    return DataLoss("{} is cut off or damaged; what came before is in {}", flags.in, flags.out);
  }
  return kSuccess;
}

constexpr const char* kImportCarmenExamples = R"(
Example:
  splinemap import-carmen intel.log.gz intel.lcmlog && splinemap build intel.lcmlog --out intel.splinemap

Channels: LASER (bot_core.planar_lidar_t), POSE (bot_core.pose_t), the pose of the laser as the log
has it, corrected where the log was corrected. Reads FLASER lines, or ROBOTLASER1 lines.)";

}  // namespace

void AddImportCarmen(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<ImportCarmenFlags>();
  CLI::App* command = app.add_subcommand("import-carmen", "Make an LCM log from a CARMEN log");
  command->footer(kImportCarmenExamples);
  command->add_option("IN", flags->in, "CARMEN log, plain or gzip")->required();
  command->add_option("OUT", flags->out, "LCM log to write")->required();
  command
      ->add_option("--rate", flags->rate_hz,
                   "Hz of scans whose time stamps are of no use (default 10)")
      ->check(CLI::Range(0.001, 1000.0));
  command->add_flag("--force", flags->force, "Replace the log if it exists");
  command->callback([flags, &chosen] { chosen = [flags] { return ImportCarmen(*flags); }; });
}

}  // namespace splinemap
