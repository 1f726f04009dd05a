#include <CLI/App.hpp>
#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "clients/splinemap/bus_flags.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "lcmtypes/splinemap/trajectory_t.hpp"
#include "lib/base/status.h"
#include "lib/logs/trajectory_file.h"
#include "lib/wire/lcm_bus.h"
#include "lib/wire/message_type.h"
#include "lib/wire/trajectory_parts.h"
#include "splinemap/client.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

constexpr size_t kPosesInPart = 1500;  // 48 kB

trajectory_t PartOf(const Trajectory& trajectory, size_t part, size_t parts,
                    const std::string& robot) {
  trajectory_t message{};
  message.utime = trajectory.until.count();
  message.robot = robot;
  message.part = static_cast<int32_t>(part);
  message.num_parts = static_cast<int32_t>(parts);
  const size_t end = std::min(trajectory.poses.size(), kPosesInPart * (part + 1));
  for (size_t k = kPosesInPart * part; k < end; ++k) {
    const auto& [utime, pose] = trajectory.poses[k];
    message.pose_utime.push_back(utime.count());
    message.x_m.push_back(pose.position_m.x());
    message.y_m.push_back(pose.position_m.y());
    message.yaw_rad.push_back(pose.yaw_rad);
  }
  message.num_poses = static_cast<int32_t>(message.pose_utime.size());
  return message;
}

struct CorrectFlags {
  std::vector<std::string> arguments;  // the map file unless `live`, and the trajectory
  std::string layer;
  bool live = false;
  BusFlags bus;
  std::string robot;
  Output output;
  double rate_hz = 10;
  bool accepts_corrupt = false;
};

absl::StatusOr<Trajectory> ReadWholeTrajectory(const CorrectFlags& flags, const std::string& path) {
  Trajectory trajectory;
  SPLINEMAP_ASSIGN_OR_RETURN(trajectory.poses, ReadTrajectory(path, flags.rate_hz));
  trajectory.until = Utime(kMaxUtime);
  SPLINEMAP_RETURN_IF_ERROR(CheckTrajectory(trajectory));
  return trajectory;
}

absl::StatusOr<int> CorrectFile(const CorrectFlags& flags) {
  if (flags.arguments.size() != 2)
    return InvalidArgument("give the map file and the trajectory, or --live and the trajectory");
  const std::string& map = flags.arguments[0];
  const std::string& path = flags.arguments[1];
  if (flags.output.path.empty()) return InvalidArgument("give the map file to write with --out");
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {map, path}));
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadInput(map, flags.accepts_corrupt));
  if (loaded.set.layers.size() != 1 && flags.layer.empty()) {
    return InvalidArgument("{} has {} layers; say which one is to be corrected with --layer", map,
                           loaded.set.layers.size());
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const Trajectory trajectory, ReadWholeTrajectory(flags, path));
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

// To the daemons that are there.
absl::StatusOr<int> CorrectLive(const CorrectFlags& flags) {
  if (flags.arguments.size() != 1 || !flags.output.path.empty()) {
    return InvalidArgument(
        "give the trajectory after --live, and no --out: the daemon's map is "
        "corrected");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const Trajectory trajectory,
                             ReadWholeTrajectory(flags, flags.arguments[0]));
  ClientOptions options;
  options.channel_prefix = flags.bus.channel_prefix;
  options.robot = flags.robot;
  SPLINEMAP_ASSIGN_OR_RETURN(options.keys, flags.bus.Keys());
  options.deadline = flags.bus.Timeout();
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, MapClient::Connect(flags.bus.lcm_url, options));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(flags.bus.lcm_url));
  const size_t parts = (trajectory.poses.size() + kPosesInPart - 1) / kPosesInPart;
  for (size_t part = 0; part < parts; ++part) {
    bus->PublishBytes(flags.bus.channel_prefix + "_TRAJECTORY",
                      Signed(options.keys.get(),
                             TrajectorySigning(flags.bus.channel_prefix, client->daemon().nonce),
                             Encode(PartOf(trajectory, part, parts, client->daemon().name))));
  }
  PrintLine(stderr, "sent {} poses to the daemon of {}; its log says what became of them",
            trajectory.poses.size(), client->daemon().name);
  return kSuccess;
}

absl::StatusOr<int> Correct(const CorrectFlags& flags) {
  return flags.live ? CorrectLive(flags) : CorrectFile(flags);
}

constexpr const char* kCorrectExamples = R"(
Examples:
  splinemap correct drive.splinemap trajectory.csv --out corrected.splinemap
  splinemap correct odometry.splinemap intel.log.gz --out corrected.splinemap
  splinemap correct --live trajectory.csv --robot robot-1

A scan at the time of a pose of the trajectory gets that pose; scans between two poses move with
both, those after the last with that one, and those before the first stay. The trajectory is a CSV
file of lines utime,x_m,y_m,yaw_rad (us, on the clock of the scans), or a corrected CARMEN log, whose
stamps are those that import-carmen gives.)";

// Without loss of what a file says.
absl::StatusOr<int> PrintTrajectory(const std::string& path, const std::string& name) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
  std::vector<LayerId> ids;
  for (const LayerSnapshot& layer : loaded.set.layers) ids.push_back(layer.id);
  if (ids.size() != 1 && name.empty())
    return InvalidArgument("{} has {} layers; name one with --layer", path, ids.size());
  LayerId id;
  if (name.empty()) {
    id = ids[0];
  } else {
    SPLINEMAP_ASSIGN_OR_RETURN(id, FindLayer(ids, name, path));
  }
  PrintLine(stdout, "utime,x_m,y_m,yaw_rad");
  loaded.set.Find(id)->archive->ForEachPose([](const ScanPose& scan) {
    const Pose2 pose = scan.world_T_robot.ToPose();
    PrintLine(stdout, "{},{:.17g},{:.17g},{:.17g}", scan.utime.count(), pose.position_m.x(),
              pose.position_m.y(), pose.yaw_rad);
  });
  return ReportCorruption(loaded);
}

}  // namespace

void AddTrajectory(CLI::App& app, Command& chosen) {
  struct TrajectoryFlags {
    std::string map, layer;
  };
  auto flags = std::make_shared<TrajectoryFlags>();
  CLI::App* command =
      app.add_subcommand("trajectory", "Print where the robot was at the scans of a map");
  command->footer(
      "\nExample:\n  splinemap trajectory drive.splinemap > trajectory.csv\n\nPrints lines "
      "utime,x_m,y_m,yaw_rad in the frame of the robot's poses, as splinemap correct reads them.");
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("--layer", flags->layer, "The layer, where there are several")
      ->type_name("NAME");
  command->callback(
      [flags, &chosen] { chosen = [flags] { return PrintTrajectory(flags->map, flags->layer); }; });
}

void AddCorrect(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<CorrectFlags>();
  CLI::App* command = app.add_subcommand("correct", "Move the scans of a map to better poses");
  command->footer(kCorrectExamples);
  command
      ->add_option("MAP TRAJECTORY", flags->arguments,
                   "Map file, or --live in its place; then a CSV file or CARMEN log")
      ->required();
  CLI::Option* const live =
      command->add_flag("--live", flags->live, "Use the map of the daemons on an LCM bus");
  AddBusFlags(*command, flags->bus, live);
  RequireLive(command
                  ->add_option("--robot", flags->robot,
                               "Robot of the daemon (default: the first to answer)")
                  ->type_name("NAME"),
              live);
  AddTimeoutFlag(*command, flags->bus, live);
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
