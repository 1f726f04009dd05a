#include <pthread.h>
#include <signal.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <memory>
#include <string>
#include <utility>

#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/config/checked_text.h"
#include "lib/config/flags.h"
#include "lib/config/usage_error.h"
#include "services/splinemapd/daemon.h"
#include "services/splinemapd/log.h"
#include "services/splinemapd/metrics.h"
#include "services/splinemapd/service_manager.h"

namespace splinemap {
namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;

struct Flags {
  InputFlags input;
  std::string lcm_url;
  std::string map;
  std::string keys;
  bool no_sensors = false;
  std::vector<std::string> follow;
  bool no_remote_commands = false;
  double forget_after_min = 0;
  uint32_t metrics_port = 0;
  bool check_config = false;
  bool print_config = false;
};

constexpr const char* kExamples = R"(
Examples:
  splinemapd --scan LASER --pose POSE
  splinemapd --scan LIDAR:michigan_2017,time_offset_ms=-250 --pose SLAM_POSE --map lab.splinemap
  splinemapd --config splinemapd.textproto --check-config
  splinemapd --scan LASER --pose POSE --name robot-1 --follow 'robot-*'
  splinemapd --no-sensors --name base    a base station: keeps and merges the layers of all robots

Maps until SIGINT (Ctrl-C), SIGTERM or SIGQUIT, and saves; SIGHUP saves and goes on, SIGPIPE, SIGUSR1
and the like do nothing. An LCM bus that is not there is waited for. Without --map the map is
NAME.splinemap in this directory; an existing file is continued. Exit status: 0 ended by signal and
saved, 1 failed, 2 usage or configuration.)";

void AddFlags(CLI::App& app, Flags& flags) {
  app.footer(kExamples);
  app.set_version_flag("--version", SPLINEMAP_VERSION);
  AddInputFlags(app, flags.input);
  app.add_option("--map", flags.map, "Map file (default: NAME.splinemap)")->type_name("FILE");
  app.add_option("--lcm-url", flags.lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  app.add_option("--keys", flags.keys,
                 "Folder of splinemap keys: sign, and believe trusted keys alone (default: none)")
      ->type_name("FOLDER");
  app.add_flag("--no-sensors", flags.no_sensors,
               "A base station: no scans, no poses, only the layers of others");
  app.add_option("--follow", flags.follow,
                 "Robot whose layer is followed, kept and summed, * and ? allowed; more than once "
                 "for several (default: nobody, or all with --no-sensors)")
      ->type_name("NAME")
      ->allow_extra_args(false);
  app.add_flag(
      "--no-remote-commands", flags.no_remote_commands,
      "Take no commands (save, clear), settings about layers and trajectories from the bus");
  app.add_option("--forget-after", flags.forget_after_min,
                 "The map is that of the scans of the last minutes (default 0: of all)")
      ->type_name("MINUTES")
      ->check(CLI::Range(0.0, 1e7));
  app.add_option("--metrics-port", flags.metrics_port,
                 "Serve metrics to Prometheus at http://127.0.0.1:PORT/metrics (default 0: none)")
      ->type_name("PORT")
      ->check(CLI::Range(0, 65535).description(""));
  app.add_flag("--check-config", flags.check_config, "Check flags and configuration, and end");
  app.add_flag("--print-config", flags.print_config,
               "Print the configuration with every option explained, and end");
}

absl::StatusOr<config::Config> ConfigOf(const Flags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(config::Config config, splinemap::ConfigOf(flags.input));
  if (!flags.map.empty()) config.set_map(flags.map);
  if (!flags.lcm_url.empty()) config.set_lcm_url(flags.lcm_url);
  if (!flags.keys.empty()) config.set_keys(flags.keys);
  if (flags.no_sensors) config.mutable_service()->set_sensors(false);
  if (!flags.follow.empty()) config.mutable_service()->clear_follow();
  for (const std::string& name : flags.follow) config.mutable_service()->add_follow(name);
  if (flags.forget_after_min > 0)
    config.mutable_service()->set_forget_after_min(flags.forget_after_min);
  if (flags.metrics_port > 0) config.mutable_service()->set_metrics_port(flags.metrics_port);
  if (flags.no_remote_commands) config.mutable_service()->set_remote_commands(false);
  return config;
}

// All signals that a process can be sent are blocked in all threads and taken here, so that none
// ends the daemon unsaved: a pipe that nobody reads, a file that may not grow, the alarm of
// somebody's script. A fault of the daemon itself ends it all the same. Ctrl-Z stops it, as usual.
class Signals {
 public:
  enum class Wish { kNothing, kSave, kEnd };

  Signals() {
    sigfillset(&set_);
    for (const int signal : {SIGTSTP, SIGCONT}) sigdelset(&set_, signal);
    pthread_sigmask(SIG_BLOCK, &set_, nullptr);
  }

  // What a signal wishes, or nothing after a second.
  Wish Wait() const {
    const Clock::time_point end = Clock::now() + std::chrono::seconds(1);
    while (Clock::now() < end) {
      const std::chrono::nanoseconds left = end - Clock::now();
      const timespec timeout{0, std::clamp<long>(left.count(), 0, 999'999'999)};
      const Wish wish = WishOf(sigtimedwait(&set_, nullptr, &timeout));
      if (wish != Wish::kNothing) return wish;
    }
    return Wish::kNothing;
  }

 private:
  static Wish WishOf(int signal) {
    switch (signal) {
      case SIGHUP:
        return Wish::kSave;
      case SIGINT:
      case SIGTERM:
      case SIGQUIT:
      case SIGPWR:
      case SIGXCPU:
      // Here only when somebody sends them.
      case SIGABRT:
      case SIGBUS:
      case SIGFPE:
      case SIGILL:
      case SIGSEGV:
      case SIGSYS:
      case SIGTRAP:
        return Wish::kEnd;
      default:
        return Wish::kNothing;
    }
  }

  sigset_t set_;
};

absl::Status Run(const config::Config& config, const Signals& signals) {
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<LcmBus> bus, LcmBus::Open(config.lcm_url()));
  SPLINEMAP_ASSIGN_OR_RETURN(std::unique_ptr<Daemon> started,
                             Daemon::Start(config, std::move(bus)));
  // Never freed: to free a large map tile by tile takes seconds, which the system does at once.
  Daemon* const daemon = started.release();
  std::unique_ptr<MetricsServer> metrics;
  if (const uint32_t port = config.service().metrics_port(); port > 0) {
    auto listening = MetricsServer::Listen(port, *daemon);
    if (!listening.ok()) {
      daemon->Stop().IgnoreError();
      return listening.status();
    }
    metrics = *std::move(listening);
  }
  ServiceManager manager;
  size_t lost_lines = 0;
  for (auto wish = Signals::Wish::kNothing; wish != Signals::Wish::kEnd; wish = signals.Wait()) {
    ReportLostLines(daemon->notices(), lost_lines);
    if (wish == Signals::Wish::kSave) daemon->SaveNow();
    daemon->PublishStatus();
    manager.SayAlive(*daemon);
  }
  manager.SayStopping();
  return daemon->Stop();
}

int Main(int argc, char** argv) {
  CLI::App app("splinemapd: maps LCM scans and poses into a continuous occupancy map.",
               "splinemapd");
  Flags flags;
  AddFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    PrintError(UsageErrorText(app, error));
    return kUsage;
  }
  const absl::StatusOr<config::Config> config = ConfigOf(flags);
  if (!config.ok()) {
    PrintError(ErrorText(config.status()));
    return kUsage;
  }
  if (flags.print_config) {
    std::fputs(PrintDocumented(*config).c_str(), stdout);
    return 0;
  }
  if (absl::Status status = CheckConfig(*config); !status.ok()) {
    PrintError(ErrorText(status));
    return kUsage;
  }
  if (flags.check_config) {
    std::puts("configuration is fine");
    return 0;
  }
  const Signals signals;  // before the first thread, which takes over what is blocked
  StartLog();
  const absl::Status status = Run(*config, signals);
  if (!status.ok()) spdlog::error("{}", ErrorText(status));
  EndLog();
  return status.ok() ? 0 : kFailed;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
