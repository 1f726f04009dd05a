// What it costs a base station to follow robots that map 10 scans a second each: processor time,
// memory, bytes on the bus. A real splinemapd follows; the robots are in this process.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <map>
#include <optional>
#include <string>
#include <thread>

#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lib/base/status.h"
#include "lib/replica/caller.h"
#include "lib/signing/key_files.h"
#include "lib/wire/decode.h"
#include "lib/wire/encode.h"
#include "tests/bench/fleet/process_figures.h"
#include "tests/bench/fleet/robot_fleet.h"
#include "tests/support/child_process.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

using std::chrono::milliseconds;
using Seconds = std::chrono::duration<double>;

constexpr double kRawTileBytes = sizeof(Tile);

enum class Sends { kTiles, kScans, kSignedScans };
constexpr const char* kSends[] = {"tiles", "scans", "signed"};

// The base station's folder, and the robots' key.
absl::StatusOr<std::shared_ptr<const KeyRing>> MakeKeys(const std::string& folder) {
  SPLINEMAP_ASSIGN_OR_RETURN(const PublicKey base, MakeSecretKey(folder + "/base"));
  SPLINEMAP_ASSIGN_OR_RETURN(const PublicKey robots, MakeSecretKey(folder + "/robots"));
  for (const char* of : {"/base", "/robots"}) {
    SPLINEMAP_RETURN_IF_ERROR(Trust(folder + of, {"base", base, {"base"}, true, true}));
    SPLINEMAP_RETURN_IF_ERROR(Trust(folder + of, {"robots", robots, {"robot-*"}, false, false}));
  }
  return KeyRing::Read(folder + "/robots");
}

struct Cost {
  int robots = 0;
  Sends sends = Sends::kTiles;
  double cpu = 0;            // s a second, of the base station
  double sent_kb_per_s = 0;  // by the robots
  double raw_kb_per_s = 0;   // of the tiles that changed, once for each scan
  double tiles_mb = 0;       // raw, of all layers at the end
  double memory_mb = 0;      // of the base station, less what it has without layers
  double equal_s = 0;        // from the last scan until it has the same bytes
  int64_t late_rounds = 0;
};

// What the base station says that it has.
class LayersHeard {
 public:
  explicit LayersHeard(LcmBus& bus) {
    bus.Subscribe("SPLINEMAP_LAYERS", [this](const std::string&, absl::Span<const uint8_t> m) {
      if (const auto layers = Decode<layers_t>(m); layers.ok()) newest_ = *layers;
    });
  }
  bool HasAny() const { return newest_.has_value(); }
  bool Has(std::vector<int64_t> hashes) const {
    std::vector<int64_t> heard;
    for (const layer_status_t& layer : newest_->layers) {
      if (layer.state != "own") heard.push_back(layer.hash);
    }
    std::sort(heard.begin(), heard.end());
    std::sort(hashes.begin(), hashes.end());
    return heard == hashes;
  }

 private:
  std::optional<layers_t> newest_;
};

template <typename Condition>
absl::Status HandleUntil(LcmBus& bus, const std::shared_ptr<const KeyRing>& keys, Seconds at_most,
                         const std::string& what, Condition condition) {
  const auto end = Clock::now() + std::chrono::duration_cast<Clock::duration>(at_most);
  Caller caller(bus, "SPLINEMAP", keys);
  while (!condition()) {
    caller.Tick(Clock::now());
    if (Clock::now() > end)
      return Unavailable("{} did not come true in {} s", what, at_most.count());
    bus.Handle(milliseconds(20));
  }
  return absl::OkStatus();
}

void HandleFor(LcmBus& bus, Seconds time) {
  const auto end = Clock::now() + std::chrono::duration_cast<Clock::duration>(time);
  while (Clock::now() < end) bus.Handle(milliseconds(20));
}

absl::StatusOr<Cost> Measure(int robots, Sends sends, const Workload& workload, Seconds time) {
  const TemporaryDirectory folder;
  SPLINEMAP_ASSIGN_OR_RETURN(auto keys, MakeKeys(folder.path()));
  if (sends != Sends::kSignedScans) keys = nullptr;
  std::vector<std::string> command{
      SPLINEMAPD_PROGRAM, "--no-sensors", "--name", "base", "--map", folder.File("base.splinemap")};
  if (keys != nullptr) command.insert(command.end(), {"--keys", folder.File("base")});
  SPLINEMAP_ASSIGN_OR_RETURN(const auto bus, LcmBus::Open(""));
  LayersHeard heard(*bus);
  const ChildProcess base(command);
  constexpr Seconds kPatience(60);
  SPLINEMAP_RETURN_IF_ERROR(
      HandleUntil(*bus, keys, kPatience, "a base station", [&] { return heard.HasAny(); }));
  const double empty_bytes = ResidentBytes(base.pid());

  RobotFleet fleet(robots, sends != Sends::kTiles, workload, *bus, keys);
  HandleFor(*bus, Seconds(2));
  const auto begin = Clock::now();
  const double cpu_before = CpuSeconds(base.pid());
  const RobotFleet::Totals before = fleet.totals();
  HandleFor(*bus, time);
  const double measured_s = Seconds(Clock::now() - begin).count();
  const RobotFleet::Totals after = fleet.totals();
  Cost cost{robots, sends};
  cost.cpu = (CpuSeconds(base.pid()) - cpu_before) / measured_s;
  cost.sent_kb_per_s = static_cast<double>(after.bytes - before.bytes) / 1000 / measured_s;
  cost.raw_kb_per_s = static_cast<double>(after.changed_tiles - before.changed_tiles) *
                      kRawTileBytes / 1000 / measured_s;
  cost.late_rounds = after.late_rounds - before.late_rounds;

  fleet.Rest();
  const auto rested = Clock::now();
  SPLINEMAP_RETURN_IF_ERROR(HandleUntil(*bus, keys, kPatience, "a base station with the same bytes",
                                        [&] { return heard.Has(fleet.Hashes()); }));
  cost.equal_s = Seconds(Clock::now() - rested).count();
  cost.tiles_mb = static_cast<double>(fleet.totals().tiles) * kRawTileBytes / 1e6;
  cost.memory_mb = (ResidentBytes(base.pid()) - empty_bytes) / 1e6;
  return cost;
}

void Print(const Cost& cost, const Cost& one) {
  fmt::print(
      "{:>6} {:>6} {:>9.3f} {:>7.1f} {:>10.0f} {:>7.1f} {:>10.0f} {:>7.3f} {:>9.1f} {:>9.1f} "
      "{:>7.2f} "
      "{:>8.1f}\n",
      cost.robots, kSends[static_cast<size_t>(cost.sends)], cost.cpu, cost.cpu / one.cpu,
      cost.sent_kb_per_s, cost.sent_kb_per_s / one.sent_kb_per_s, cost.raw_kb_per_s,
      cost.sent_kb_per_s / cost.raw_kb_per_s, cost.tiles_mb, cost.memory_mb,
      cost.memory_mb / cost.tiles_mb, cost.equal_s);
  if (cost.late_rounds > 0) {
    fmt::print("       {} of the robots' rounds were late: the machine is too slow for this\n",
               cost.late_rounds);
  }
  std::fflush(stdout);
}

// Of one message.
absl::Status PrintSignatures() {
  constexpr int kTimes = 2000;
  const TemporaryDirectory folder;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto keys, MakeKeys(folder.path()));
  const auto cpu_us = [] {
    timespec time{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return 1e6 * static_cast<double>(time.tv_sec) + 1e-3 * static_cast<double>(time.tv_nsec);
  };
  const auto time_us = [&](auto call) {
    const double begin_us = cpu_us();
    for (int k = 0; k < kTimes; ++k) call();
    return (cpu_us() - begin_us) / kTimes;
  };
  for (const int content_bytes : {0, 1000}) {
    layer_updates_t updates{};
    updates.layer.name = "robot-1";
    updates.num_tiles = 1;
    updates.tiles.resize(1);
    updates.tiles[0].num_bytes = content_bytes;
    updates.tiles[0].content.resize(content_bytes);
    const std::vector<uint8_t> message = Encode(updates);
    const std::vector<uint8_t> signed_message = Signed(keys.get(), "C", message);
    fmt::print("{} bytes: signed in {:.0f} us, checked in {:.0f} us\n", message.size(),
               time_us([&] { Signed(keys.get(), "C", message); }), time_us([&] {
                 if (!keys->SignerOf("C", signed_message).ok()) std::abort();
               }));
  }
  return absl::OkStatus();
}

absl::Status Run(int robots, double seconds, int max_scans) {
  SPLINEMAP_RETURN_IF_ERROR(PrintSignatures());
  auto workload = MakeWorkload("intel", max_scans);
  if (!workload) workload = MakeWorkload("simulated_360_beams_3.5_m", max_scans);
  fmt::print("A base station that follows robots on {}, 10 scans a second each, {:g} s\n",
             workload->name, seconds);
  fmt::print("{:>6} {:>6} {:>9} {:>7} {:>10} {:>7} {:>10} {:>7} {:>9} {:>9} {:>7} {:>8}\n",
             "robots", "send", "cpu, s/s", "to one", "sent, kB/s", "to one", "raw, kB/s", "ratio",
             "tiles, MB", "RSS, MB", "ratio", "equal, s");
  for (const Sends sends : {Sends::kTiles, Sends::kScans, Sends::kSignedScans}) {
    std::optional<Cost> one;
    for (const int number : {1, robots}) {
      SPLINEMAP_ASSIGN_OR_RETURN(const Cost cost,
                                 Measure(number, sends, *workload, Seconds(seconds)));
      if (!one) one = cost;
      Print(cost, *one);
    }
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("fleet_bench: what following a fleet costs; run it by deploy/own_bus.sh");
  bool quick = false;
  int robots = 20;
  double seconds = 30;
  app.add_flag("--quick", quick, "For 2 s; the figures say nothing");
  app.add_option("--robots", robots, "Beside one alone")->check(CLI::Range(2, 200));
  app.add_option("--seconds", seconds, "s that are measured");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = Run(robots, quick ? 2 : seconds, quick ? 500 : 1'000'000);
  if (!status.ok()) fmt::print(stderr, "fleet_bench: {}\n", ErrorText(status));
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
