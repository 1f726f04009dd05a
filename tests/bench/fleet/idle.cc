// What daemons cost that have nothing to do: processor time, wake-ups, bytes on the bus. Real
// daemons that all follow each other, with no tiles, with tiles, and when one of them has left.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/wire/lcm_bus.h"
#include "tests/bench/fleet/map_files.h"
#include "tests/bench/fleet/process_figures.h"
#include "tests/support/child_process.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;
using Seconds = std::chrono::duration<double>;

constexpr size_t kHeaderBytes = 8 + 1;  // of LCM, beside the name of the channel

struct Traffic {
  int64_t messages = 0;
  int64_t bytes = 0;
};

class Bus {
 public:
  static absl::StatusOr<std::unique_ptr<Bus>> Open() {
    std::unique_ptr<Bus> bus(new Bus);
    SPLINEMAP_ASSIGN_OR_RETURN(bus->lcm_, LcmBus::Open(""));
    bus->lcm_->SubscribeToAll([&heard = bus->heard_](const std::string& channel, auto message) {
      Traffic& traffic = heard[channel];
      ++traffic.messages;
      traffic.bytes += static_cast<int64_t>(kHeaderBytes + channel.size() + message.size());
    });
    return bus;
  }
  // By channel.
  std::map<std::string, Traffic> ListenFor(Seconds time) {
    heard_.clear();
    const auto end = Clock::now() + std::chrono::duration_cast<Clock::duration>(time);
    while (Clock::now() < end) lcm_->Handle(milliseconds(100));
    return heard_;
  }

 private:
  std::map<std::string, Traffic> heard_;
  std::unique_ptr<LcmBus> lcm_;
};

class Daemons {
 public:
  Daemons(int number, bool have_sensors, const TemporaryDirectory& folder) {
    for (int k = 0; k < number; ++k) {
      std::vector<std::string> arguments{SPLINEMAPD_PROGRAM, "--name", NameOf(k), "--map",
                                         FileOf(folder, k)};
      const std::vector<std::string> kind =
          have_sensors
              ? std::vector<std::string>{"--scan", "LASER", "--pose", "POSE", "--follow", "*"}
              : std::vector<std::string>{"--no-sensors"};
      arguments.insert(arguments.end(), kind.begin(), kind.end());
      running_.push_back(std::make_unique<ChildProcess>(arguments));
    }
  }
  static std::string NameOf(int k) { return fmt::format("robot-{}", k); }
  static std::string FileOf(const TemporaryDirectory& folder, int k) {
    return folder.File(NameOf(k) + ".splinemap");
  }
  void StopOne() { running_.pop_back(); }
  size_t size() const { return running_.size(); }
  double cpu_s() const {
    double sum = 0;
    for (const auto& daemon : running_) sum += CpuSeconds(daemon->pid());
    return sum;
  }
  int64_t wakeups() const {
    int64_t sum = 0;
    for (const auto& daemon : running_) sum += Wakeups(daemon->pid());
    return sum;
  }

 private:
  std::vector<std::unique_ptr<ChildProcess>> running_;
};

void Measure(const std::string& what, const Daemons& daemons, Bus& bus, Seconds time) {
  const double cpu_s = daemons.cpu_s();
  const int64_t wakeups = daemons.wakeups();
  const std::map<std::string, Traffic> heard = bus.ListenFor(time);
  const auto number = static_cast<double>(daemons.size());
  Traffic all;
  for (const auto& [channel, traffic] : heard) {
    all.messages += traffic.messages;
    all.bytes += traffic.bytes;
  }
  fmt::print("{:>7} {:<28} {:>8.3f} {:>10.1f} {:>9.2f} {:>9.1f}", daemons.size(), what,
             100 * (daemons.cpu_s() - cpu_s) / time.count() / number,
             static_cast<double>(daemons.wakeups() - wakeups) / time.count() / number,
             static_cast<double>(all.bytes) / 1000 / time.count(),
             static_cast<double>(all.messages) / time.count());
  for (const auto& [channel, traffic] : heard) {
    fmt::print(" {} {:.2f}", channel.substr(channel.find('_') + 1),
               static_cast<double>(traffic.bytes) / 1000 / time.count());
  }
  fmt::print("\n");
  std::fflush(stdout);
}

absl::Status Run(int number, int64_t tiles, Seconds time, Seconds settling) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<Bus> bus, Bus::Open());
  fmt::print("{:>7} {:<28} {:>8} {:>10} {:>9} {:>9}\n", "", "", "% of a", "wake-ups", "", "");
  fmt::print("{:>7} {:<28} {:>8} {:>10} {:>9} {:>9} kB/s of channels\n", "daemons", "", "core each",
             "a s, each", "kB/s", "mess./s");
  for (const bool have_sensors : {false, true}) {
    const std::string kind = have_sensors ? "with sensors" : "without sensors";
    for (const int64_t tiles_each : {int64_t{0}, tiles}) {
      const TemporaryDirectory folder;
      for (int k = 0; k < number; ++k) {
        SPLINEMAP_RETURN_IF_ERROR(
            WriteMap(Daemons::FileOf(folder, k), Daemons::NameOf(k), tiles_each));
      }
      Daemons daemons(number, have_sensors, folder);
      bus->ListenFor(settling);
      Measure(fmt::format("{}, {} tiles", kind, tiles_each), daemons, *bus, time);
      if (tiles_each == 0) continue;
      daemons.StopOne();
      bus->ListenFor(settling);
      Measure("  when one has left", daemons, *bus, time);
    }
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("idle_bench: what idle daemons cost; run it by deploy/own_bus.sh");
  bool quick = false;
  int daemons = 8;
  int64_t tiles = 1000;
  double seconds = 60;
  app.add_flag("--quick", quick, "3 daemons for 1 s; the figures say nothing");
  app.add_option("--daemons", daemons, "That follow each other")->check(CLI::Range(1, 200));
  app.add_option("--tiles", tiles, "Of each layer")->check(CLI::Range(1, 1'000'000));
  app.add_option("--seconds", seconds, "s that are measured");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = quick ? Run(3, 10, Seconds(1), Seconds(2))
                                    : Run(daemons, tiles, Seconds(seconds), Seconds(20));
  if (!status.ok()) fmt::print(stderr, "idle_bench: {}\n", ErrorText(status));
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
