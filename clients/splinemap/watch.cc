#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/live_view.h"
#include "clients/splinemap/say.h"
#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"

namespace splinemap {
namespace {

constexpr std::chrono::milliseconds kDrawInterval(1000);
constexpr std::chrono::milliseconds kWatchTick(50);

struct WatchFlags {
  std::string lcm_url;
  std::string prefix = "SPLINEMAP";
  double timeout_s = 5;
  bool json = false;
  bool once = false;
};

nlohmann::json Counts(const std::vector<std::string>& names, const std::vector<int64_t>& counts) {
  nlohmann::json json = nlohmann::json::object();
  for (size_t k = 0; k < names.size(); ++k) json[names[k]] = counts[k];
  return json;
}

nlohmann::json ToJson(const status_t& status) {
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
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.lcm_url));
  FollowOptions follow;
  follow.channel_prefix = flags.prefix;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, MapReplica::Follow(flags.lcm_url, follow));
  LiveView view(*replica);
  bus->Subscribe(flags.prefix + "_STATUS",
                 [&](const std::string&, absl::Span<const uint8_t> message) {
                   const absl::StatusOr<status_t> status = Decode<status_t>(message);
                   if (status.ok()) view.HandleStatus(*status);
                 });
  fmt::print("\x1b[2J");
  auto next_draw = Clock::now();
  while (true) {
    bus->Handle(kWatchTick);
    const auto now = Clock::now();
    if (now < next_draw) continue;
    next_draw = now + kDrawInterval;
    fmt::print("{}", view.Draw(now));
    if (std::fflush(stdout) != 0) return kFailed;
  }
}

absl::StatusOr<int> Watch(const WatchFlags& flags) {
  if (isatty(STDOUT_FILENO) == 1 && !flags.json && !flags.once) return DrawLive(flags);
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.lcm_url));
  const std::string channel = flags.prefix + "_STATUS";
  int64_t seen = 0;
  bool is_written = true;
  bus->Subscribe(channel, [&](const std::string&, absl::Span<const uint8_t> message) {
    const absl::StatusOr<status_t> status = Decode<status_t>(message);
    if (!status.ok()) {
      Say(stderr, "{}: {}", channel, ErrorText(status.status()));
      return;
    }
    ++seen;
    if (flags.json) {
      PrintJson(ToJson(*status), -1);
    } else {
      Say(stdout, "{}", StatusLine(*status));
    }
    is_written = std::fflush(stdout) == 0;
  });
  const auto timeout = std::chrono::duration<double>(flags.timeout_s);
  for (auto heard = Clock::now(); Clock::now() - heard < timeout;) {
    if (bus->Handle(kWatchTick) == LcmBus::Handled::kMessage) heard = Clock::now();
    if (const auto news = bus->DrainNews()) Say(stderr, "{}", *news);
    if (!is_written) return kFailed;  // whom it wrote to went
    if (flags.once && seen > 0) return kSuccess;
  }
  if (!bus->Problem().empty()) return Unavailable("{}", bus->Problem());
  return Unavailable("heard nothing on {} for {:g} s; does splinemapd run on this bus?", channel,
                     flags.timeout_s);
}

constexpr const char* kWatchExamples = R"(
Examples:
  splinemap watch
  splinemap watch --json --once --lcm-url 'udpm://239.255.76.67:7667?ttl=0'

In a terminal: daemons, the layers that are followed, and the map, until Ctrl-C. "state of" says how
old what is shown may be at most; "tiles asked" are those that were lost on the way or that were there
before. Elsewhere, and with --json or --once: what the daemons say of themselves, a line each a
second; ends with status 1 when nothing was heard for --timeout.)";

}  // namespace

void AddWatch(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<WatchFlags>();
  CLI::App* command =
      app.add_subcommand("watch", "Show how the daemons on a bus are doing, and their map");
  command->footer(kWatchExamples);
  command->add_option("--lcm-url", flags->lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  command->add_option("--prefix", flags->prefix, "channel_prefix of the daemons");
  command->add_option("--timeout", flags->timeout_s, "s of silence until it ends (default 5)")
      ->check(CLI::Range(0.1, 1e6));
  command->add_flag("--json", flags->json, "One JSON object a line");
  command->add_flag("--once", flags->once, "End after the first message");
  command->callback([flags, &chosen] { chosen = [flags] { return Watch(*flags); }; });
}

}  // namespace splinemap
