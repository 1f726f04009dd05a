#include <algorithm>
#include <chrono>
#include <memory>
#include <thread>

#include "absl/strings/escaping.h"
#include "clients/replica/map_replica.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct Flags {
  std::string out;
  std::string lcm_url;
  FollowOptions follow;
  double timeout_s = 10;
  bool force = false;
};

std::string Name(const FollowedLayer& layer) { return absl::Utf8SafeCHexEscape(layer.id.name); }

// Every daemon says once a second what it has; in this time nearly always all of them are heard.
constexpr std::chrono::milliseconds kHearAll(2500);

absl::Status WaitUntilInSync(const MapReplica& replica, const Flags& flags) {
  const auto begin = Clock::now();
  const auto timeout = std::chrono::duration<double>(flags.timeout_s);
  while (Clock::now() - begin < timeout) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const std::vector<FollowedLayer> layers = replica.Layers();
    const bool all_in_sync =
        std::all_of(layers.begin(), layers.end(), [](const FollowedLayer& l) { return l.in_sync; });
    const bool all_heard = std::all_of(
        flags.follow.names.begin(), flags.follow.names.end(), [&](const std::string& name) {
          return std::any_of(layers.begin(), layers.end(),
                             [&](const FollowedLayer& l) { return l.id.name == name; });
        });
    if (!layers.empty() && all_in_sync && all_heard && Clock::now() - begin > kHearAll) {
      return absl::OkStatus();
    }
  }
  std::string missing;
  for (const std::string& name : replica.Refused()) {
    missing += fmt::format("; {} is not followed: another version", absl::Utf8SafeCHexEscape(name));
  }
  for (const FollowedLayer& layer : replica.Layers()) {
    if (!layer.in_sync)
      missing += fmt::format("; {} has {} tiles so far", Name(layer), layer.tiles);
  }
  if (missing.empty()) {
    return Unavailable("heard no map on {}_DIGESTS for {:g} s; does splinemapd run on this bus?",
                       flags.follow.channel_prefix, flags.timeout_s);
  }
  return Unavailable("the map is not whole after {:g} s{}; give it more with --timeout",
                     flags.timeout_s, missing);
}

absl::StatusOr<int> TakeSnapshot(const Flags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.out, flags.force));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, MapReplica::Follow(flags.lcm_url, flags.follow));
  SPLINEMAP_RETURN_IF_ERROR(WaitUntilInSync(*replica, flags));
  const auto map = replica->WholeSnapshot();
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(*map, flags.out));
  for (const std::string& name : replica->Refused()) {
    fmt::print(stderr, "{} is left out: another knot interval, other clamps or another version\n",
               absl::Utf8SafeCHexEscape(name));
  }
  for (const LayerSnapshot& layer : map->layers) {
    fmt::print(stderr, "{}: {} tiles, commit {}\n", absl::Utf8SafeCHexEscape(layer.id.name),
               layer.tiles.size(), layer.revision);
  }
  return replica->Refused().empty() ? kSuccess : kFailed;
}

constexpr const char* kExamples = R"(
Examples:
  splinemap snapshot lab.splinemap
  splinemap snapshot --robot one --lcm-url 'udpm://239.255.76.67:7667?ttl=0' one.splinemap

Follows the daemons on a bus until it has their maps byte for byte, and saves them as one file. Exit
status: 0 saved, 1 not whole within --timeout or a layer left out, 2 usage.)";

}  // namespace

void AddSnapshot(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand("snapshot", "Save the map that daemons on a bus have");
  command->footer(kExamples);
  command->add_option("OUT", flags->out, "Map file to write")->required();
  command->add_option("--lcm-url", flags->lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  command->add_option("--prefix", flags->follow.channel_prefix, "channel_prefix of the daemons");
  command
      ->add_option("--robot", flags->follow.names, "Only the layers of this robot; may be repeated")
      ->type_name("NAME");
  command->add_option("--timeout", flags->timeout_s, "s until it gives up (default 10)")
      ->check(CLI::Range(0.1, 1e6));
  command->add_flag("--force", flags->force, "Replace OUT");
  command->callback([flags, &chosen] { chosen = [flags] { return TakeSnapshot(*flags); }; });
}

}  // namespace splinemap
