// Clients that ask the workers of a fleet. Prints how many queries a second are answered, and how
// soon.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <functional>
#include <memory>
#include <mutex>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "fmt/format.h"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_flags.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/fleet_map.h"
#include "tests/bench/fleet/process_figures.h"

namespace splinemap::bench {
namespace {

constexpr std::chrono::seconds kDeadline(10);

struct Flags {
  FleetAddress fleet;
  int clients = 8;
  double seconds = 5;
  std::vector<pid_t> workers;
};

using Random = std::mt19937_64;

// A place that fleet_load has mapped: one of 8 squares of 51 m, some metres around its middle.
Eigen::Vector2d Place(Random& random) {
  const double side_m = kSquareSide * Tile::kSide * 0.05;
  const auto square = random() % 8;
  std::uniform_real_distribution<double> within(5, 20);
  return {2 * static_cast<double>(square % 4) * side_m + within(random),
          2 * static_cast<double>(square / 4) * side_m + within(random)};
}

absl::Status AskPoints(const FleetMap& map, Random& random, size_t count) {
  PointsQuery query;
  const Eigen::Vector2d place = Place(random);
  std::uniform_real_distribution<double> around(-3, 3);
  for (size_t k = 0; k < count; ++k) {
    query.points_m.push_back(place + Eigen::Vector2d(around(random), around(random)));
  }
  return map.Ask(query).status();
}

absl::Status AskRays(const FleetMap& map, Random& random) {
  RaysQuery query;
  const Eigen::Vector2d place = Place(random);
  query.unknown = UnknownPolicy::kFree;
  for (int k = 0; k < 180; ++k) query.rays.push_back({place, k * M_PI / 90, 5});
  return map.Ask(query).status();
}

absl::Status Measure(const Flags& flags, const std::string& name,
                     const std::function<absl::Status(const FleetMap&, Random&)>& ask) {
  std::vector<std::unique_ptr<FleetMap>> maps;
  for (int k = 0; k < flags.clients; ++k) {
    SPLINEMAP_ASSIGN_OR_RETURN(maps.emplace_back(), FleetMap::Connect(flags.fleet, kDeadline));
  }
  std::vector<double> cpu_before;
  for (const pid_t worker : flags.workers) cpu_before.push_back(CpuSecondsOfAll(worker));
  std::mutex mutex;
  std::vector<double> took_ms;
  absl::Status failed;
  const auto begin = Clock::now();
  const auto end = begin + std::chrono::duration_cast<Clock::duration>(
                               std::chrono::duration<double>(flags.seconds));
  {
    std::vector<std::jthread> clients;
    for (int k = 0; k < flags.clients; ++k) {
      clients.emplace_back([&, k] {
        Random random(static_cast<uint64_t>(k));
        std::vector<double> took;
        while (Clock::now() < end) {
          const auto asked = Clock::now();
          const absl::Status status = ask(*maps[static_cast<size_t>(k)], random);
          took.push_back(std::chrono::duration<double, std::milli>(Clock::now() - asked).count());
          if (status.ok()) continue;
          const std::lock_guard lock(mutex);
          failed = status;
          return;
        }
        const std::lock_guard lock(mutex);
        took_ms.insert(took_ms.end(), took.begin(), took.end());
      });
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(failed);
  const double passed_s = std::chrono::duration<double>(Clock::now() - begin).count();
  std::sort(took_ms.begin(), took_ms.end());
  std::string cpu;
  for (size_t k = 0; k < flags.workers.size(); ++k) {
    cpu += fmt::format(" {:.0f} %",
                       (CpuSecondsOfAll(flags.workers[k]) - cpu_before[k]) / passed_s * 100);
  }
  fmt::print("{:<24} {:>8.0f}/s {:>8.2f} ms median {:>8.2f} ms for 99 %   workers:{}\n", name,
             static_cast<double>(took_ms.size()) / passed_s, took_ms[took_ms.size() / 2],
             took_ms[took_ms.size() * 99 / 100], cpu);
  return absl::OkStatus();
}

absl::Status Run(const Flags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(Measure(flags, "1 point", [](const FleetMap& map, Random& random) {
    return AskPoints(map, random, 1);
  }));
  SPLINEMAP_RETURN_IF_ERROR(Measure(flags, "1,000 points", [](const FleetMap& map, Random& random) {
    return AskPoints(map, random, 1000);
  }));
  return Measure(flags, "180 rays", AskRays);
}

int Main(int argc, char** argv) {
  CLI::App app("fleet_queries: clients that ask the workers of a fleet.", "fleet_queries");
  Flags flags;
  AddFleetFlags(app, flags.fleet)->required();
  app.add_option("--clients", flags.clients, "How many ask at a time");
  app.add_option("--seconds", flags.seconds, "For each kind of query");
  app.add_option("--worker", flags.workers, "Process id of a worker to be measured");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = Run(flags);
  if (status.ok()) return 0;
  fmt::print(stderr, "{}\n", ErrorText(status));
  return 1;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
