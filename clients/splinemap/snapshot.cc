#include <CLI/App.hpp>
#include <algorithm>
#include <chrono>
#include <memory>
#include <utility>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/fleet_scans.h"
#include "clients/splinemap/follow.h"
#include "clients/splinemap/follow_fleet.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/status.h"
#include "lib/config/region_flag.h"
#include "lib/fleet/fleet_flags.h"
#include "lib/logs/lcm_log.h"
#include "lib/replication/map_follower.h"
#include "splinemap/layer_set.h"

namespace splinemap {
namespace {

struct SnapshotFlags {
  Output output;
  BusFlags bus;
  FleetAddress fleet;
  std::string log;
  std::string region;
  std::string statistic = "mean";
  bool scans = false;
  FollowOptions follow;
};

absl::Status Save(const LayerSet& map, const std::string& out) {
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(map, out));
  for (const LayerSnapshot& layer : map.layers) {
    PrintLine(stderr, "{}: {} tiles, commit {}", layer.id.name, layer.tiles.size(), layer.revision);
  }
  return absl::OkStatus();
}

absl::StatusOr<int> FollowLog(const SnapshotFlags& flags) {
  FollowOptions options = flags.follow;
  options.channel_prefix = flags.bus.channel_prefix;
  MapFollower follower(options, 0);  // its requests are not published
  const std::vector<std::string> channels = ReplicationChannels(options.channel_prefix);
  Clock::time_point now;
  absl::Status read;
  {
    ProgressBar bar("following");
    read = ReadLcmLog(
        flags.log,
        [&](const LogEvent& event) {
          if (std::find(channels.begin(), channels.end(), event.channel) == channels.end()) return;
          constexpr Utime kMax(int64_t{1} << 52);  // in 140 years; files may have any time
          now = Clock::time_point(std::clamp(event.utime, Utime(0), kMax));
          follower.HandleBytes(event.message, now);
        },
        [&](double share) { bar.Show(share); });
  }
  if (!read.ok()) PrintLine(stderr, "{}", ErrorText(read));
  const LayerSet map = follower.SyncedLayers();
  if (map.layers.empty()) {
    return FailedPrecondition(
        "no layer in {} has caught up, {}. A log that begins after the daemon has the whole map "
        "only where a follower requested it meanwhile, as splinemap snapshot does",
        flags.log,
        follower.FollowedLayers(now).empty()
            ? fmt::format("{}_DIGESTS has no messages", options.channel_prefix)
            : "updates are missing");
  }
  SPLINEMAP_RETURN_IF_ERROR(Save(map, flags.output.path));
  bool is_complete = read.ok();
  for (const std::string& refused : follower.refused()) {
    PrintLine(stderr, "left out: {}", refused);
    is_complete = false;
  }
  for (const FollowedLayer& layer : follower.FollowedLayers(now)) {
    if (layer.matches_digest) continue;
    PrintLine(
        stderr,
        "{}: the log lacks what came after commit {}. lcm-logger drops messages while 30 wait: "
        "record the map alone, by lcm-logger --channel='{}_.*'",
        layer.id.name, layer.revision, options.channel_prefix);
    is_complete = false;
  }
  return is_complete ? kSuccess : kFailed;
}

absl::StatusOr<int> FollowBus(const SnapshotFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, FollowUntilCaughtUp(flags.bus, flags.follow));
  SPLINEMAP_RETURN_IF_ERROR(Save(replica->SyncedLayers(), flags.output.path));
  return ReportRefused(replica->Refused());
}

absl::StatusOr<int> CopyFleet(const SnapshotFlags& flags) {
  FleetFollowOptions options;
  options.names = flags.follow.names;
  options.region = flags.follow.region;
  SPLINEMAP_ASSIGN_OR_RETURN(const FollowedFleet fleet,
                             FollowWholeFleet(flags.fleet, options, flags.bus.Timeout()));
  LayerSet map = fleet.replica->WholeLayers();
  if (map.layers.empty()) {
    return NotFound("the fleet's map '{}' has no layer{}, so nothing is written", flags.fleet.map,
                    flags.region.empty() ? "" : " in --region " + flags.region);
  }
  int exit_status = kSuccess;
  if (flags.scans) {
    SPLINEMAP_ASSIGN_OR_RETURN(exit_status, TakeScans(flags.fleet, flags.output.path, map));
  }
  SPLINEMAP_RETURN_IF_ERROR(Save(map, flags.output.path));
  return std::max(exit_status, ReportRefused(fleet.replica->Refused()));
}

absl::StatusOr<int> TakeSnapshot(SnapshotFlags flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(flags.follow.region, ParseRegion(flags.region));
  flags.follow.level_of_detail.statistic = flags.statistic == "min"   ? Statistic::kMin
                                           : flags.statistic == "max" ? Statistic::kMax
                                                                      : Statistic::kMean;
  if (!flags.follow.level_of_detail.IsValid()) {
    return InvalidArgument("--statistic {} requires a --level above 0", flags.statistic);
  }
  // Once, what daemons make of a large map is less to send than all of it.
  flags.follow.takes_tiles = flags.follow.level_of_detail.level > 0;
  std::vector<std::string> inputs;
  if (!flags.log.empty()) inputs.push_back(flags.log);
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, inputs));
  if (!flags.fleet.servers.empty()) return CopyFleet(flags);
  return flags.log.empty() ? FollowBus(flags) : FollowLog(flags);
}

constexpr const char* kSnapshotExamples = R"(
Examples:
  splinemap snapshot lab.splinemap
  splinemap snapshot --robot one --lcm-url 'udpm://239.255.76.67:7667?ttl=0' one.splinemap
  splinemap snapshot --region -5,-5,20,10 --level 2 --statistic max obstacles.splinemap
  splinemap snapshot --log recorded.lcmlog lab.splinemap
  splinemap snapshot --fleet nats://hub --robot 'robot-1*' --region 0,0,50,20 lab.splinemap
  splinemap snapshot --fleet nats://hub --scans --robot robot-1 one.splinemap
  splinemap forget one.splinemap --before end-1h --out now.splinemap

Follows the daemons on a bus until it has caught up with them byte for byte, and saves their layers
as one file. At level n the knot interval is 2^n times as wide. The mean is smoothed; min and max
are the least and the greatest log-odds of 2^n x 2^n control points. Exit status: 0 saved; 1 not
caught up within --timeout, or saved without a layer; 2 usage.
With --fleet it saves each layer as its robot last completed it; --region selects the layers that
reach into the region, and saves them whole. --timeout is the time without anything new.
--scans takes layers, with their scans, from the copies of map files that splinemap-uplink --map
brings every five minutes, and says how old each is. A layer without a copy is saved without scans;
so is one whose copy cannot be used, with exit status 1. Then fold, forget, correct and verify work
on OUT; fold and forget need the scans of all its layers: --robot selects. What they make is a file
and no more: when the robot is back, its layer is as the robot has it.)";

}  // namespace

void AddSnapshot(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<SnapshotFlags>();
  flags->bus.timeout_s = kCatchUpTimeout_s;
  CLI::App* command =
      app.add_subcommand("snapshot", "Save the map of the daemons on an LCM bus, or of a fleet");
  command->footer(kSnapshotExamples);
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  AddBusFlags(*command, flags->bus);
  AddRobotsFlag(*command, flags->follow.names);
  AddTimeoutFlag(*command, flags->bus);
  AddRegionFlag(*command, flags->region);
  command
      ->add_option("--level", flags->follow.level_of_detail.level,
                   "Level of detail (default 0, as mapped)")
      ->check(CLI::Range(0, LevelOfDetail::kMaxLevel));
  command->add_option("--statistic", flags->statistic, "Statistic of a level (default mean)")
      ->check(CLI::IsMember({"mean", "min", "max"}));
  command->add_option("--log", flags->log, "Follow the messages in an LCM log instead of a bus")
      ->excludes("--lcm-url", "--region", "--level");
  CLI::Option* const fleet = AddFleetFlags(*command, flags->fleet);
  fleet->excludes("--lcm-url", "--prefix", "--keys", "--level", "--statistic", "--log");
  command->add_flag("--scans", flags->scans, "With their scans, where robots bring their map files")
      ->needs(fleet);
  command->callback([flags, &chosen] { chosen = [flags] { return TakeSnapshot(*flags); }; });
}

}  // namespace splinemap
