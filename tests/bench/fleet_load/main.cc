// Robots that bring recorded drives to NATS servers, as splinemap-uplink does: an upload and a
// connection for each, at the speed of the drive. Prints what they send, how late the fleet has it,
// and what it costs.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "fmt/format.h"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_replica.h"
#include "lib/fleet/layer_digest.h"
#include "lib/fleet/layer_upload.h"
#include "lib/fleet/nats_fleet_store.h"
#include "services/uplink/pace.h"
#include "tests/bench/fleet/process_figures.h"
#include "tests/bench/fleet_load/drive_states.h"

namespace splinemap::bench {
namespace {

struct Flags {
  std::string fleet = "nats://127.0.0.1:4222";
  std::string map = "load";
  int robots = 100;
  double seconds = 30;
  double interval_s = 2;
  int replicas = 3;
  double max_kb_per_s = 100;
  std::vector<pid_t> servers;
};

struct Totals {
  std::atomic<int64_t> blocks{0};
  std::atomic<int64_t> bytes{0};
  std::atomic<int64_t> digests{0};
  std::atomic<int64_t> failures{0};
  std::mutex mutex;
  std::vector<double> lags_s;  // from a state to its acknowledged digest
  std::string problem;
};

double Seconds(Clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(share * static_cast<double>(values.size() - 1))];
}

// One robot, from its connection on.
void Drive(const Flags& flags, const DriveStates& drive, int robot, Clock::time_point begin,
           Clock::time_point end, Totals& totals) {
  FleetAddress address;
  address.servers = flags.fleet;
  address.map = flags.map;
  address.program = "fleet_load";
  auto store = NatsFleetStore::Connect(address);
  if (!store.ok()) {
    ++totals.failures;
    const std::lock_guard lock(totals.mutex);
    totals.problem = ErrorText(store.status());
    return;
  }
  const LayerId id{fmt::format("robot-{}", robot), static_cast<uint64_t>(robot) + 1};
  LayerUpload upload(**store, id, drive.options);
  const auto interval =
      std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(flags.interval_s));
  // Robots begin one after the other, in half of the time, each with an empty map.
  Clock::time_point due = begin + (end - begin) / 2 * robot / flags.robots;
  size_t state = 0;
  Pace pace(flags.max_kb_per_s * 1000);
  int failures = 0;
  while (due < end) {
    std::this_thread::sleep_until(due);
    LayerSnapshot layer = drive.states[std::min(state++, drive.states.size() - 1)];
    layer.id = id;
    const LayerUpload::Counts before = upload.counts();
    const absl::Status status = upload.Bring(layer, [&](int64_t bytes) {
      std::this_thread::sleep_until(pace.Take(bytes, Clock::now()));
      return true;
    });
    const Clock::time_point now = Clock::now();
    if (!status.ok()) {
      ++totals.failures;
      const std::lock_guard lock(totals.mutex);
      totals.problem = ErrorText(status);
    } else if (due > begin + (end - begin) / 2) {  // all robots are there
      totals.blocks += upload.counts().blocks - before.blocks;
      totals.bytes += upload.counts().bytes - before.bytes;
      totals.digests += upload.counts().digests - before.digests;
      const std::lock_guard lock(totals.mutex);
      totals.lags_s.push_back(Seconds(now - due));
    }
    failures = status.ok() ? 0 : failures + 1;
    due = std::max(due + interval, now) + interval * failures;
  }
}

absl::Status Run(const Flags& flags) {
  FleetAddress address;
  address.servers = flags.fleet;
  address.map = flags.map;
  address.program = "fleet_load";
  SPLINEMAP_ASSIGN_OR_RETURN(const auto store, NatsFleetStore::Connect(address));
  SPLINEMAP_RETURN_IF_ERROR(store->MakeBucket(flags.replicas));
  std::vector<DriveStates> drives;
  constexpr int kPlaces = 8;
  for (int place = 0; place < kPlaces; ++place) {
    SPLINEMAP_ASSIGN_OR_RETURN(
        drives.emplace_back(),
        MapDrive(place % 2 == 0 ? "intel-corrected.log.gz" : "freiburg-079-corrected.log.gz",
                 flags.interval_s, 2 * (place % 4), 2 * (place / 4)));
  }
  const auto written = store->PutIf({kMapKey, EncodeMapOptions(drives[0].options), 1}, 0);
  if (!written.ok() && !absl::IsAborted(written.status())) return written.status();
  std::vector<double> cpu_s;
  cpu_s.resize(flags.servers.size());
  double own_s = 0;
  Totals totals;
  const Clock::time_point begin = Clock::now() + std::chrono::milliseconds(500);
  const Clock::time_point end = begin + std::chrono::duration_cast<Clock::duration>(
                                            std::chrono::duration<double>(flags.seconds));
  {
    std::vector<std::jthread> robots;
    robots.emplace_back([&] {
      std::this_thread::sleep_until(begin + (end - begin) / 2);
      for (size_t k = 0; k < flags.servers.size(); ++k) {
        cpu_s[k] = CpuSecondsOfAll(flags.servers[k]);
      }
      own_s = CpuSecondsOfAll(getpid());
      std::this_thread::sleep_until(end);
      for (size_t k = 0; k < flags.servers.size(); ++k) {
        cpu_s[k] = CpuSecondsOfAll(flags.servers[k]) - cpu_s[k];
      }
      own_s = CpuSecondsOfAll(getpid()) - own_s;
    });
    for (int robot = 0; robot < flags.robots; ++robot) {
      robots.emplace_back(
          [&, robot] { Drive(flags, drives[robot % kPlaces], robot, begin, end, totals); });
    }
  }
  const double passed_s = Seconds(end - begin) / 2;
  const double share = 100 / passed_s;
  fmt::print("{} robots, a state every {:g} s, {} replicas, {:.0f} s after as many to begin\n",
             flags.robots, flags.interval_s, flags.replicas, passed_s);
  fmt::print("updates: {:.0f} digests/s, {:.0f} blocks/s, {:.2f} MB/s; {:.1f} kB/s a robot\n",
             static_cast<double>(totals.digests) / passed_s,
             static_cast<double>(totals.blocks) / passed_s,
             static_cast<double>(totals.bytes) / passed_s / 1e6,
             static_cast<double>(totals.bytes) / passed_s / flags.robots / 1e3);
  fmt::print(
      "from a state to its acknowledged digest: {:.0f} ms median, {:.0f} ms for 99 %, {:.0f} "
      "ms at most\n",
      1e3 * Quantile(totals.lags_s, 0.5), 1e3 * Quantile(totals.lags_s, 0.99),
      1e3 * Quantile(totals.lags_s, 1));
  fmt::print("robots: {:.2f} % of a core each, {:.2f} MB each\n", own_s * share / flags.robots,
             ResidentBytes(getpid()) / 1e6 / flags.robots);
  for (size_t k = 0; k < flags.servers.size(); ++k) {
    fmt::print("server {}: {:.0f} % of a core, {:.0f} MB; {:.3f} % and {:.0f} kB a robot\n", k + 1,
               cpu_s[k] * share, ResidentBytes(flags.servers[k]) / 1e6,
               cpu_s[k] * share / flags.robots,
               ResidentBytes(flags.servers[k]) / 1e3 / flags.robots);
  }
  fmt::print("failures: {}{}\n", totals.failures.load(),
             totals.problem.empty() ? "" : ", the last: " + totals.problem);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("fleet_load: robots that bring recorded drives to NATS servers.", "fleet_load");
  Flags flags;
  app.add_option("--fleet", flags.fleet, "NATS servers")->type_name("URL[,URL]..");
  app.add_option("--fleet-map", flags.map, "Name of the map")->type_name("NAME");
  app.add_option("--robots", flags.robots, "How many");
  app.add_option("--seconds", flags.seconds, "For how long");
  app.add_option("--interval-s", flags.interval_s, "Seconds between two states of a robot");
  app.add_option("--replicas", flags.replicas, "Of the bucket");
  app.add_option("--server", flags.servers, "Process id of a server to be measured");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = Run(flags);
  if (status.ok()) return 0;
  fmt::print(stderr, "{}\n", ErrorText(status));
  return 1;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
