#include <unistd.h>

#include <CLI/App.hpp>
#include <chrono>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "clients/splinemap/bus_flags.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/live_view.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/watch_fleet.h"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/status.h"
#include "lib/fleet/fleet_flags.h"
#include "lib/replica/caller.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {
namespace {

constexpr std::chrono::milliseconds kDrawInterval(1000);
constexpr std::chrono::milliseconds kWatchTick(50);

struct WatchFlags {
  BusFlags bus;
  FleetAddress fleet;
  bool json = false;
  bool once = false;
};

nlohmann::json Counts(const std::vector<std::string>& names, const std::vector<int64_t>& counts) {
  nlohmann::json json = nlohmann::json::object();
  for (size_t k = 0; k < names.size(); ++k) json[names[k]] = counts[k];
  return json;
}

nlohmann::json StatusToJson(const status_t& status) {
  return {{"utime", status.utime},
          {"name", status.name},
          {"origin", fmt::format("{:016x}", static_cast<uint64_t>(status.origin))},
          {"session_number", status.session_number},
          {"uptime_s", status.uptime_s},
          {"messages_received", status.messages_received},
          {"scans_received", status.scans_received},
          {"poses_received", status.poses_received},
          {"scans_mapped", status.scans_mapped},
          {"dropped", Counts(status.drop_reasons, status.drop_counts)},
          {"problems", Counts(status.problems, status.problem_counts)},
          {"messages_queued", status.messages_queued},
          {"scans_queued", status.scans_queued},
          {"newest_scan_utime", status.newest_scan_utime},
          {"newest_scan_age_s", status.newest_scan_age_s},
          {"scan_time_mean_ms", status.scan_time_mean_ms},
          {"scan_time_max_ms", status.scan_time_max_ms},
          {"revision", status.revision},
          {"saved_revision", status.saved_revision},
          {"tiles", status.tiles},
          {"map_bytes", status.map_bytes},
          {"last_problem", status.last_problem}};
}

// Until the user ends it.
absl::StatusOr<int> DrawLive(const WatchFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.bus.lcm_url));
  FollowOptions follow;
  follow.channel_prefix = flags.bus.channel_prefix;
  SPLINEMAP_ASSIGN_OR_RETURN(follow.keys, flags.bus.Keys());
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, MapReplica::Follow(flags.bus.lcm_url, follow));
  LiveView view(*replica);
  bus->Subscribe(flags.bus.channel_prefix + "_STATUS",
                 [&](const std::string&, absl::Span<const uint8_t> message) {
                   const absl::StatusOr<status_t> status = Decode<status_t>(message);
                   if (status.ok()) view.HandleStatus(*status);
                 });
  fmt::print("\x1b[2J");
  Caller caller(*bus, flags.bus.channel_prefix, follow.keys);
  auto next_draw = Clock::now();
  while (true) {
    bus->Handle(kWatchTick);
    const auto now = Clock::now();
    caller.Tick(now);
    if (now < next_draw) continue;
    next_draw = now + kDrawInterval;
    fmt::print("{}", view.Draw(now));
    if (std::fflush(stdout) != 0) return kFailed;
  }
}

absl::StatusOr<int> Watch(const WatchFlags& flags) {
  const bool draws = isatty(STDOUT_FILENO) == 1 && !flags.json && !flags.once;
  if (!flags.fleet.servers.empty()) {
    if (draws) return DrawFleet(flags.fleet);
    return PrintFleet(flags.fleet, flags.bus.Timeout(), flags.json, flags.once);
  }
  if (draws) return DrawLive(flags);
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.bus.lcm_url));
  SPLINEMAP_ASSIGN_OR_RETURN(const auto keys, flags.bus.Keys());
  const std::string channel = flags.bus.channel_prefix + "_STATUS";
  int64_t seen = 0;
  bool is_written = true;
  bus->Subscribe(channel, [&](const std::string&, absl::Span<const uint8_t> message) {
    const absl::StatusOr<status_t> status = Decode<status_t>(message);
    if (!status.ok()) {
      PrintLine(stderr, "{}: {}", channel, ErrorText(status.status()));
      return;
    }
    ++seen;
    if (flags.json) {
      PrintJson(StatusToJson(*status), -1);
    } else {
      PrintLine(stdout, "{}", StatusLine(*status));
    }
    is_written = std::fflush(stdout) == 0;
  });
  Caller caller(*bus, flags.bus.channel_prefix, keys);
  for (auto received = Clock::now(); Clock::now() - received < flags.bus.Timeout();) {
    caller.Tick(Clock::now());
    if (bus->Handle(kWatchTick) == LcmBus::Handled::kMessage) received = Clock::now();
    if (const auto news = bus->DrainNews()) PrintLine(stderr, "{}", *news);
    if (!is_written) return kFailed;  // the reader is gone
    if (flags.once && seen > 0) return kSuccess;
  }
  if (!bus->Problem().empty()) return Unavailable("{}", bus->Problem());
  return Unavailable("nothing was received on {} in {:g} s; is splinemapd on this bus?", channel,
                     flags.bus.timeout_s);
}

constexpr const char* kWatchExamples = R"(
Examples:
  splinemap watch
  splinemap watch --json --once --lcm-url 'udpm://239.255.76.67:7667?ttl=0'
  splinemap watch --fleet nats://hub

In a terminal it draws the daemons, the layers that it follows and the map, until Ctrl-C.
"staleness" is the greatest age of the tiles shown; "requested" counts tiles that were lost on the
way, or published before. Elsewhere, and with --json or --once, it prints one line a second for each
daemon, and ends with status 1 when it receives nothing for --timeout.
With --fleet it shows the layers of a fleet, and whether each is whole: all that its robot counted
is there. The first line comes when all was looked at; it ends when the servers are away for
--timeout.)";

}  // namespace

void AddWatch(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<WatchFlags>();
  flags->bus.timeout_s = 5;
  CLI::App* command =
      app.add_subcommand("watch", "Show the daemons on an LCM bus, or a fleet, and their map");
  command->footer(kWatchExamples);
  AddBusFlags(*command, flags->bus);
  AddTimeoutFlag(*command, flags->bus);
  AddFleetFlags(*command, flags->fleet)->excludes("--lcm-url", "--prefix", "--keys");
  command->add_flag("--once", flags->once, "End after the first message");
  AddJsonFlag(*command, flags->json);
  command->callback([flags, &chosen] { chosen = [flags] { return Watch(*flags); }; });
}

}  // namespace splinemap
