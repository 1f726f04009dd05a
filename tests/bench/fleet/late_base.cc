// How soon a base station that comes late has the map of a robot, and how soon both end: with the
// budget of the robot's daemon as it is by default, and raised. Real daemons.
#include <fmt/format.h>
#include <signal.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/replica/caller.h"
#include "lib/wire/decode.h"
#include "lib/wire/lcm_bus.h"
#include "splinemap/file.h"
#include "tests/bench/fleet/map_files.h"
#include "tests/bench/fleet/process_figures.h"
#include "tests/support/child_process.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;
using Seconds = std::chrono::duration<double>;

double SecondsSince(Clock::time_point begin) { return Seconds(Clock::now() - begin).count(); }

// What is published: bytes of the map, and how many tiles the base station says that it has.
class Bus {
 public:
  static absl::StatusOr<std::unique_ptr<Bus>> Open() {
    std::unique_ptr<Bus> bus(new Bus);
    SPLINEMAP_ASSIGN_OR_RETURN(bus->lcm_, LcmBus::Open(""));
    for (const char* channel : {"SPLINEMAP_UPDATES", "SPLINEMAP_LISTINGS", "SPLINEMAP_PULLS"}) {
      bus->lcm_->Subscribe(channel, [b = bus.get()](const std::string& name, auto message) {
        b->bytes_ += std::ssize(message);
        if (name == "SPLINEMAP_UPDATES") b->last_tiles_ = Clock::now();
      });
    }
    bus->lcm_->Subscribe("SPLINEMAP_LAYERS", [b = bus.get()](const std::string&, auto message) {
      if (const auto layers = Decode<layers_t>(message); layers.ok()) b->HandleLayers(*layers);
    });
    return bus;
  }

  // Asks who is there, and waits until the daemon has so many tiles of the robot, all of them.
  absl::Status Await(const std::string& daemon, int64_t tiles, Seconds at_most) {
    const auto begin = Clock::now();
    Caller caller(*lcm_, "SPLINEMAP");
    while (tiles_[daemon] < tiles) {
      if (SecondsSince(begin) > at_most.count()) {
        return Unavailable("{} has {} tiles of {} after {} s", daemon, tiles_[daemon], tiles,
                           at_most.count());
      }
      caller.Tick(Clock::now());
      lcm_->Handle(milliseconds(20));
    }
    return absl::OkStatus();
  }
  int64_t bytes() const { return bytes_; }
  // When the last tiles came: daemons say up to a second later that they have all.
  Clock::time_point last_tiles() const { return last_tiles_; }

 private:
  void HandleLayers(const layers_t& layers) {
    for (const layer_status_t& layer : layers.layers) {
      if (layer.settings.name == "robot" && layer.state != "stale")
        tiles_[layers.name] = layer.num_tiles;
    }
  }

  std::unique_ptr<LcmBus> lcm_;
  std::map<std::string, int64_t> tiles_;  // by daemon
  int64_t bytes_ = 0;
  Clock::time_point last_tiles_;
};

// Seconds from SIGINT until the process is gone.
double SecondsToEnd(const ChildProcess& process) {
  const auto begin = Clock::now();
  kill(process.pid(), SIGINT);
  siginfo_t info{};
  waitid(P_PID, static_cast<id_t>(process.pid()), &info, WEXITED | WNOWAIT);
  return SecondsSince(begin);
}

absl::Status Measure(const std::string& map, int64_t tiles, double budget_kb_per_s) {
  const TemporaryDirectory folder;
  const std::string config = folder.File("config.textproto");
  std::ofstream(config) << fmt::format("service {{ max_publish_kb_per_s: {} }}", budget_kb_per_s);
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<Bus> bus, Bus::Open());
  const ChildProcess robot({SPLINEMAPD_PROGRAM, "--config", config, "--scan", "LASER", "--pose",
                            "POSE", "--name", "robot", "--map", map});
  SPLINEMAP_RETURN_IF_ERROR(bus->Await("robot", tiles, Seconds(120)));
  const double robot_cpu_s = CpuSeconds(robot.pid());
  const int64_t bytes = bus->bytes();
  const auto begin = Clock::now();
  const ChildProcess base({SPLINEMAPD_PROGRAM, "--config", config, "--no-sensors", "--name", "base",
                           "--map", folder.File("base.splinemap")});
  SPLINEMAP_RETURN_IF_ERROR(bus->Await("base", tiles, Seconds(1200)));
  const double passed_s = Seconds(bus->last_tiles() - begin).count();
  const double sent_mb = 1e-6 * static_cast<double>(bus->bytes() - bytes);
  const double robot_cpu = (CpuSeconds(robot.pid()) - robot_cpu_s) / passed_s;
  const double base_cpu = CpuSeconds(base.pid()) / passed_s;
  const double base_end_s = SecondsToEnd(base);
  const double robot_end_s = SecondsToEnd(robot);
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap saved, ReadMapFile(folder.File("base.splinemap")));
  size_t saved_tiles = 0;
  for (const LayerSnapshot& layer : saved.set.layers) saved_tiles += layer.tiles.size();
  if (static_cast<int64_t>(saved_tiles) != tiles) {
    return Unavailable("the base station saved {} tiles of {}", saved_tiles, tiles);
  }
  fmt::print("{:>11.0f} {:>9} {:>8.1f} {:>9.0f} {:>7.2f} {:>10.2f} {:>9.2f} {:>10.2f} {:>9.2f}\n",
             budget_kb_per_s, tiles, passed_s, static_cast<double>(tiles) / passed_s,
             sent_mb / passed_s, robot_cpu, base_cpu, base_end_s, robot_end_s);
  std::fflush(stdout);
  return absl::OkStatus();
}

absl::Status Run(int64_t tiles, const std::vector<double>& budgets_kb_per_s) {
  const TemporaryDirectory folder;
  const std::string map = folder.File("robot.splinemap");
  SPLINEMAP_RETURN_IF_ERROR(WriteMap(map, "robot", tiles));
  fmt::print("{:>11} {:>9} {:>8} {:>9} {:>7} {:>10} {:>9} {:>10} {:>9}\n", "", "", "has all", "",
             "", "CPU, s/s:", "", "end, s:", "");
  fmt::print("{:>11} {:>9} {:>8} {:>9} {:>7} {:>10} {:>9} {:>10} {:>9}\n", "budget kB/s", "tiles",
             "after, s", "tiles/s", "MB/s", "robot", "base", "base", "robot");
  for (const double budget : budgets_kb_per_s) {
    SPLINEMAP_RETURN_IF_ERROR(Measure(map, tiles, budget));
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("late_base_bench: a base station that comes late; run it by deploy/own_bus.sh");
  bool quick = false;
  int64_t tiles = 100'000;
  std::vector<double> budgets_kb_per_s{1000, 10'000, 100'000};
  app.add_flag("--quick", quick, "1,000 tiles; the figures say nothing");
  app.add_option("--tiles", tiles, "Of the robot's map")->check(CLI::Range(1, 2'000'000));
  app.add_option("--budgets", budgets_kb_per_s, "max_publish_kb_per_s, of the robot");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = quick ? Run(1000, {10'000}) : Run(tiles, budgets_kb_per_s);
  if (!status.ok()) fmt::print(stderr, "late_base_bench: {}\n", ErrorText(status));
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
