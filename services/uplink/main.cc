#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>

#include "lib/base/clock.h"
#include "lib/base/file.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/config/region_flag.h"
#include "lib/config/usage_error.h"
#include "lib/fleet/fleet_flags.h"
#include "services/uplink/uplink.h"
#include "splinemap/key_ring.h"

namespace splinemap {
namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;
constexpr std::chrono::seconds kReportInterval(60);

std::atomic<bool> is_over = false;

// The NATS library waits for seconds for servers that do not answer. What is sent then is nothing
// that would be lost.
void End(int) {
  is_over = true;
  RemoveTemporaryFilesAtSignals();
  signal(SIGALRM, [](int) { raise(SIGTERM); });
  alarm(1);
}

constexpr const char* kExamples = R"(
Examples:
  splinemap-uplink --fleet nats://10.0.0.1:4222
  splinemap-uplink --robot one --fleet tls://a:4222,tls://b:4222 --credentials /etc/splinemap/one
  splinemap-uplink --robot one --fleet nats://localhost:4222 --max-kb-per-s 30 --follow '*' \
      --region 0,0,50,30

Brings the map of a robot's daemon to its fleet, the newest state of what has changed, at most so
many bytes a second; after days without a link, what differs. With --follow it brings the layers of
other robots to the robot's bus, where they are layers like those of robots beside it; the daemon
takes them with --follow, too. The daemon works the same without it. Ends with Ctrl-C.)";

struct Flags {
  UplinkOptions uplink;
  std::string keys;
  std::string region;
  double interval_s = 2;
};

void AddFlags(CLI::App& app, Flags& flags) {
  app.footer(kExamples);
  app.set_version_flag("--version", std::string("splinemap-uplink ") + SPLINEMAP_VERSION);
  AddFleetFlags(app, flags.uplink.fleet)->required();
  app.add_option("--robot", flags.uplink.bus.robot,
                 "Robot whose layer is brought (default: the first on the bus)")
      ->type_name("NAME");
  app.add_option("--lcm-url", flags.uplink.bus.lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  app.add_option("--prefix", flags.uplink.bus.channel_prefix, "channel_prefix of the daemon");
  app.add_option("--keys", flags.keys,
                 "Folder of splinemap keys: sign, and believe trusted keys alone")
      ->type_name("FOLDER");
  app.add_option("--max-kb-per-s", flags.uplink.max_kb_per_s,
                 "Most kilobytes a second that are sent to the fleet (default 100)")
      ->type_name("KB")
      ->check(CLI::Range(1.0, 1e6));
  app.add_option("--interval-s", flags.interval_s,
                 "Seconds in which changes are gathered before they are sent (default 2)")
      ->type_name("SECONDS")
      ->check(CLI::Range(0.1, 3600.0));
  app.add_option("--follow", flags.uplink.bus.others,
                 "Robot of the fleet whose layer is brought here, * and ? allowed; more than once "
                 "for several (default: nobody)")
      ->type_name("NAME")
      ->allow_extra_args(false);
  app.add_option("--map", flags.uplink.map_file,
                 "Map file of the daemon, of which a copy with all scans is brought every five "
                 "minutes, while nothing else is to be sent (default: none)")
      ->type_name("FILE");
  AddRegionFlag(app, flags.region)
      ->description("Only robots that have mapped something in this part of the map, in metres");
}

absl::Status Complete(Flags& flags) {
  flags.uplink.interval = std::chrono::milliseconds(static_cast<int64_t>(flags.interval_s * 1000));
  SPLINEMAP_ASSIGN_OR_RETURN(flags.uplink.region, ParseRegion(flags.region));
  if (flags.uplink.region && flags.uplink.bus.others.empty()) {
    return InvalidArgument("--region is of the layers that --follow names; give it, too");
  }
  if (!flags.keys.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(flags.uplink.bus.keys, KeyRing::Read(flags.keys));
  }
  return CheckFleetAddress(flags.uplink.fleet);
}

void Report(const Uplink::State& state) {
  fmt::print(stderr,
             "{}: commit {} here, {} in the fleet; sent {} blocks, {:.1f} MB; {} layers of others, "
             "{:.1f} MB received\n",
             PlainText(state.layer.name), state.revision_here, state.revision_there,
             state.sent.blocks, static_cast<double>(state.sent.bytes) / 1e6, state.layers_of_others,
             static_cast<double>(state.bytes_received) / 1e6);
}

absl::Status Run(const Flags& flags) {
  fmt::print(stderr, "looking for the fleet at {}, and for {} on the bus (Ctrl-C ends)\n",
             flags.uplink.fleet.servers,
             flags.uplink.bus.robot.empty() ? "a robot" : PlainText(flags.uplink.bus.robot));
  const auto uplink = Uplink::Start(flags.uplink, [] { return is_over.load(); });
  if (is_over) return absl::OkStatus();
  if (!uplink.ok()) return uplink.status();
  std::string problem;
  bool is_told = false;
  Clock::time_point next_report;
  while (!is_over) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    const Uplink::State state = (*uplink)->state();
    if ((*uplink)->IsOver()) return absl::PermissionDeniedError(state.problem);
    if (state.problem != problem) {
      problem = state.problem;
      fmt::print(stderr, "{}\n", problem.empty() ? "all is well again" : PlainText(problem));
    }
    const bool is_first = !is_told && state.revision_there > 0;
    if (!is_first && (Clock::now() < next_report || state.revision_there == 0)) continue;
    is_told = true;
    next_report = Clock::now() + kReportInterval;
    Report(state);
  }
  if (const Uplink::State state = (*uplink)->state();
      state.revision_here > 0 || state.layers_of_others > 0) {
    Report(state);
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app(
      "splinemap-uplink: brings a robot's map to its fleet, and others' maps to the robot.",
      "splinemap-uplink");
  Flags flags;
  AddFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    fmt::print(stderr, "{}\n", UsageErrorText(app, error));
    return kUsage;
  }
  signal(SIGPIPE, SIG_IGN);
  for (const int number : {SIGINT, SIGTERM}) signal(number, End);
  absl::Status status = Complete(flags);
  if (status.ok()) status = Run(flags);
  if (status.ok()) return 0;
  fmt::print(stderr, "{}\n", PlainLines(ErrorText(status)));
  return absl::IsInvalidArgument(status) ? kUsage : kFailed;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
