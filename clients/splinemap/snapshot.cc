#include <algorithm>
#include <chrono>
#include <memory>
#include <thread>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/progress.h"
#include "clients/splinemap/region_flag.h"
#include "clients/splinemap/say.h"
#include "lib/base/status.h"
#include "lib/logs/lcm_log.h"
#include "lib/replica/map_replica.h"
#include "lib/replication/map_follower.h"

namespace splinemap {
namespace {

struct SnapshotFlags {
  std::string out;
  std::string lcm_url;
  std::string log;
  std::string region;
  std::string statistic = "value";
  FollowOptions follow;
  double timeout_s = 10;
  bool force = false;
};

std::string Name(const FollowedLayer& layer) { return PlainText(layer.id.name); }

// Every daemon says once a second what it has; in this time nearly always all of them are heard.
constexpr std::chrono::duration<double> kHearAll(2.5);

absl::Status WaitUntilCaughtUp(const MapReplica& replica, const SnapshotFlags& flags) {
  const auto begin = Clock::now();
  const auto timeout = std::chrono::duration<double>(flags.timeout_s);
  while (Clock::now() - begin < timeout) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const std::vector<FollowedLayer> layers = replica.FollowedLayers();
    const bool all_caught_up =
        std::all_of(layers.begin(), layers.end(),
                    [](const FollowedLayer& l) { return l.caught_up && l.matches_digest; });
    const bool all_heard = std::all_of(
        flags.follow.names.begin(), flags.follow.names.end(), [&](const std::string& pattern) {
          return std::any_of(layers.begin(), layers.end(), [&](const FollowedLayer& l) {
            return MatchesName(pattern, l.id.name);
          });
        });
    if (!layers.empty() && all_caught_up && all_heard &&
        Clock::now() - begin > std::min(kHearAll, timeout / 2)) {
      return absl::OkStatus();
    }
  }
  if (const std::string problem = replica.BusProblem(); !problem.empty()) {
    return Unavailable("{}", problem);
  }
  std::string missing;
  for (const std::string& refused : replica.Refused()) {
    missing += fmt::format("; not followed: {}", PlainText(refused));
  }
  for (const FollowedLayer& layer : replica.FollowedLayers()) {
    if (!layer.caught_up || !layer.matches_digest)
      missing += fmt::format("; {} has {} tiles so far", Name(layer), layer.tiles);
  }
  for (const std::string& name : flags.follow.names) {
    const auto layers = replica.FollowedLayers();
    if (!layers.empty() && std::none_of(layers.begin(), layers.end(), [&](const FollowedLayer& l) {
          return MatchesName(name, l.id.name);
        })) {
      missing += fmt::format("; {} is not heard", PlainText(name));
    }
  }
  if (missing.empty()) {
    return Unavailable("heard no map on {}_DIGESTS for {:g} s; does splinemapd run on this bus?",
                       flags.follow.channel_prefix, flags.timeout_s);
  }
  return Unavailable("the map is not whole after {:g} s{}; give it more with --timeout",
                     flags.timeout_s, missing);
}

// Saves what is whole, and says what is not.
absl::StatusOr<int> Save(const LayerSet& map, const std::vector<std::string>& refused,
                         const SnapshotFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(map, flags.out));
  for (const std::string& name_and_why : refused) {
    Say(stderr, "left out: {}", name_and_why);
  }
  for (const LayerSnapshot& layer : map.layers) {
    Say(stderr, "{}: {} tiles, commit {}", layer.id.name, layer.tiles.size(), layer.revision);
  }
  return refused.empty() ? kSuccess : kFailed;
}

absl::StatusOr<int> ReadFromLog(const SnapshotFlags& flags) {
  MapFollower follower(flags.follow, 0);  // which has nobody to ask
  const std::vector<std::string> channels = ReplicationChannels(flags.follow.channel_prefix);
  Clock::time_point now;
  absl::Status read;
  {
    ProgressBar bar("following");
    read = ReadLcmLog(
        flags.log,
        [&](const LogEvent& event) {
          if (std::find(channels.begin(), channels.end(), event.channel) == channels.end()) return;
          constexpr Utime kMax(int64_t{1} << 52);  // in 140 years; files may say anything
          now = Clock::time_point(std::clamp(event.utime, Utime(0), kMax));
          follower.HandleBytes(event.message, now);
        },
        [&](double share) { bar.Show(share); });
  }
  if (!read.ok()) Say(stderr, "{}", ErrorText(read));
  const LayerSet map = follower.SyncedLayers();
  if (map.layers.empty()) {
    return FailedPrecondition(
        "no map is whole in {}: {}; a log that begins after the daemon has the whole map only "
        "where a follower asked for it meanwhile, as splinemap snapshot does",
        flags.log,
        follower.FollowedLayers(now).empty()
            ? fmt::format("nothing is on {}_DIGESTS", flags.follow.channel_prefix)
            : "updates are missing");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(int exit_status, Save(map, follower.refused(), flags));
  for (const FollowedLayer& layer : follower.FollowedLayers(now)) {
    if (layer.matches_digest) continue;
    Say(stderr, "{}: what follows commit {} is not whole in the log", Name(layer), layer.revision);
    exit_status = kFailed;
  }
  return read.ok() ? exit_status : kFailed;
}

absl::StatusOr<int> ReadFromBus(const SnapshotFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, MapReplica::Follow(flags.lcm_url, flags.follow));
  SPLINEMAP_RETURN_IF_ERROR(WaitUntilCaughtUp(*replica, flags));
  return Save(replica->SyncedLayers(), replica->Refused(), flags);
}

absl::StatusOr<int> TakeSnapshot(SnapshotFlags flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(flags.follow.region, ParseRegion(flags.region));
  flags.follow.level_of_detail.statistic = flags.statistic == "min"   ? Statistic::kMin
                                           : flags.statistic == "max" ? Statistic::kMax
                                                                      : Statistic::kMean;
  if (!flags.follow.level_of_detail.IsValid()) {
    return InvalidArgument("--statistic {} is of coarser levels; add --level", flags.statistic);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.out, flags.force));
  return flags.log.empty() ? ReadFromBus(flags) : ReadFromLog(flags);
}

constexpr const char* kSnapshotExamples = R"(
Examples:
  splinemap snapshot lab.splinemap
  splinemap snapshot --robot one --lcm-url 'udpm://239.255.76.67:7667?ttl=0' one.splinemap
  splinemap snapshot --region=-5,-5,20,10 --level 2 --statistic max obstacles.splinemap
  splinemap snapshot --log recorded.lcmlog lab.splinemap

Follows the daemons on a bus until it has their maps byte for byte, and saves them as one file. At
level n the knot interval is 2^n times as wide; values are smoothed, min and max are the least and the
greatest log-odds of each square of 2^n x 2^n control points. Exit status: 0 saved, 1 not whole within
--timeout or a layer left out, 2 usage.)";

}  // namespace

void AddSnapshot(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<SnapshotFlags>();
  CLI::App* command = app.add_subcommand("snapshot", "Save the map that daemons on a bus have");
  command->footer(kSnapshotExamples);
  command->add_option("OUT", flags->out, "Map file to write")->required();
  command->add_option("--lcm-url", flags->lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  command->add_option("--prefix", flags->follow.channel_prefix, "channel_prefix of the daemons");
  command
      ->add_option("--robot", flags->follow.names,
                   "Only the layers of this robot, * and ? allowed; may be repeated")
      ->type_name("NAME");
  command
      ->add_option("--region", flags->region, "Only tiles about this part of the map frame, in m")
      ->type_name("X0,Y0,X1,Y1");
  command
      ->add_option("--level", flags->follow.level_of_detail.level,
                   "Level of level_of_detail (default 0: as mapped)")
      ->check(CLI::Range(0, LevelOfDetail::kMaxLevel));
  command->add_option("--statistic", flags->statistic, "Of coarser levels (default value)")
      ->check(CLI::IsMember({"value", "min", "max"}));
  command->add_option("--log", flags->log, "Follow what this LCM log has, instead of a bus")
      ->excludes("--lcm-url", "--region", "--level");
  command->add_option("--timeout", flags->timeout_s, "s until it gives up (default 10)")
      ->check(CLI::Range(0.1, 1e6));
  command->add_flag("--force", flags->force, "Replace OUT");
  command->callback([flags, &chosen] { chosen = [flags] { return TakeSnapshot(*flags); }; });
}

}  // namespace splinemap
