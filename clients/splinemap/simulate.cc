#include <google/protobuf/text_format.h>

#include <CLI/App.hpp>
#include <cmath>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/config/checked_text.h"
#include "lib/logs/lcm_log.h"
#include "lib/simulation/simulation.h"
#include "lib/wire/encode.h"

namespace splinemap {
namespace {

struct SimulateFlags {
  bool force = false;
  std::vector<std::string> files;  // [WORLD] OUT
  double scan_rate_hz = 10;
  double pose_rate_hz = 50;
  uint64_t seed = 1;
  ScannerOptions scanner;
  std::string trajectory_path;
  std::string world_path;
};

// The drive begins at this time of the log: some tools take 0 for "no time".
constexpr Utime kStart = std::chrono::seconds(1);

Utime UtimeAt(double time_s) { return kStart + Utime(std::llround(time_s * 1e6)); }

absl::StatusOr<simulation::World> LoadWorld(const SimulateFlags& flags) {
  if (flags.files.size() == 1) return OfficeFloor();
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string text, ReadFile(flags.files.front()));
  simulation::World world;
  SPLINEMAP_RETURN_IF_ERROR(ParseCheckedText(text, flags.files.front(), &world));
  return world;
}

absl::Status CheckOutputs(const SimulateFlags& flags) {
  std::vector<std::string> read = flags.files;
  read.pop_back();
  for (const std::string& path : {flags.files.back(), flags.trajectory_path, flags.world_path}) {
    if (path.empty()) continue;
    SPLINEMAP_RETURN_IF_ERROR(CheckOutput({path, flags.force}, read));
  }
  return absl::OkStatus();
}

absl::StatusOr<int> Simulate(const SimulateFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutputs(flags));
  SPLINEMAP_ASSIGN_OR_RETURN(const simulation::World world, LoadWorld(flags));
  SPLINEMAP_ASSIGN_OR_RETURN(const Drive drive, Drive::Plan(world));
  SPLINEMAP_ASSIGN_OR_RETURN(LcmLogWriter writer, LcmLogWriter::Create(flags.files.back()));
  std::string trajectory = "utime_us,x_m,y_m,yaw_rad\n";
  std::mt19937_64 random(flags.seed);
  ProgressBar bar("driving");
  int64_t scans = 0;
  int64_t poses = 0;
  // Scans and poses in order of time, up to the first pose after the last scan.
  double pose_s = 0;
  while (pose_s <= drive.duration_s() + 1 / flags.pose_rate_hz) {
    const double scan_s = static_cast<double>(scans) / flags.scan_rate_hz;
    if (scan_s < pose_s && scan_s <= drive.duration_s()) {
      ++scans;
      SPLINEMAP_RETURN_IF_ERROR(
          writer.Write(UtimeAt(scan_s), "LASER",
                       PlanarLidarMessage(
                           UtimeAt(scan_s),
                           SimulateScan(world, scan_s, drive.PoseAt(scan_s), flags.scanner, random),
                           flags.scanner.FirstBearing(), flags.scanner.BearingStep())));
      bar.Show(scan_s / drive.duration_s());
    } else {
      const TimedPose pose{UtimeAt(pose_s), drive.PoseAt(pose_s)};
      SPLINEMAP_RETURN_IF_ERROR(writer.Write(pose.utime, "POSE", PoseMessage(pose)));
      trajectory += fmt::format("{},{:.6f},{:.6f},{:.6f}\n", pose.utime.count(),
                                pose.world_T_robot.position_m.x(),
                                pose.world_T_robot.position_m.y(), pose.world_T_robot.yaw_rad);
      pose_s = static_cast<double>(++poses) / flags.pose_rate_hz;
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(writer.Close());
  if (!flags.trajectory_path.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(WriteFile(flags.trajectory_path, trajectory));
  }
  if (!flags.world_path.empty()) {
    std::string text;
    google::protobuf::TextFormat::PrintToString(world, &text);
    SPLINEMAP_RETURN_IF_ERROR(WriteFile(flags.world_path, text));
  }
  PrintLine(stderr, "{} scans and {} poses over {:.1f} s written to {}", scans, poses,
            drive.duration_s(), flags.files.back());
  return kSuccess;
}

constexpr const char* kSimulateExamples = R"(
Examples:
  splinemap simulate office.lcmlog
  splinemap simulate office.lcmlog --world-out office.world --trajectory truth.csv
  splinemap simulate office.world changed.lcmlog --seed 2 --noise 0.03

Writes the channels LASER (bot_core.planar_lidar_t) and POSE (bot_core.pose_t, the true pose).
Without WORLD it simulates an office floor with a corridor, rooms, pillars, chair legs of 5 cm and a
door that closes. A world is Protobuf text; --world-out writes the one in use, for you to edit.)";

}  // namespace

void AddSimulate(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<SimulateFlags>();
  CLI::App* command = app.add_subcommand("simulate", "Simulate a drive and write it as an LCM log");
  command->footer(kSimulateExamples);
  command->add_option("[WORLD] OUT", flags->files, "World, if any; then the LCM log to write")
      ->required()
      ->expected(1, 2);
  command->add_option("--rate", flags->scan_rate_hz, "Hz, scans (default 10)")
      ->check(CLI::Range(0.1, 1000.0));
  command->add_option("--pose-rate", flags->pose_rate_hz, "Hz, poses (default 50)")
      ->check(CLI::Range(0.1, 1000.0));
  command->add_option("--beams", flags->scanner.num_beams, "Beams per scan (default 360)")
      ->check(CLI::Range(1, 16384));
  command->add_option("--range-max", flags->scanner.range_max_m, "m, maximum range (default 12)")
      ->check(CLI::Range(0.1, 1000.0));
  command
      ->add_option("--noise", flags->scanner.noise_sigma_m,
                   "m, standard deviation of the ranges (default 0.01)")
      ->check(CLI::Range(0.0, 10.0));
  command->add_option("--seed", flags->seed, "Seed of the noise (default 1)");
  command->add_option("--trajectory", flags->trajectory_path, "CSV file to write, the true poses")
      ->type_name("FILE");
  command->add_option("--world-out", flags->world_path, "File to write, the world")
      ->type_name("FILE");
  AddForceFlag(*command, flags->force);
  command->callback([flags, &chosen] { chosen = [flags] { return Simulate(*flags); }; });
}

}  // namespace splinemap
