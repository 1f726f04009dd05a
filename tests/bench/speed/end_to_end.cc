// Whole processes over whole recorded drives: `splinemap build`, which reads the log, maps and
// saves, and MRPT's grid, which reads the same log and maps.
#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "fmt/format.h"
#include "lib/base/status.h"
#include "lib/logs/carmen_log.h"
#include "tests/bench/speed/benchmarks.h"
#include "tests/support/shared_data.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

double Seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

double ChildrenCpuSeconds() {
  rusage usage;
  getrusage(RUSAGE_CHILDREN, &usage);
  return Seconds(usage.ru_utime) + Seconds(usage.ru_stime);
}

void Run(benchmark::State& state, const std::string& command, size_t scans) {
  const double cpu_before_s = ChildrenCpuSeconds();
  for (auto _ : state) {
    if (std::system((command + " > /dev/null 2>&1").c_str()) != 0) {
      state.SkipWithError("the program failed");
      return;
    }
  }
  state.SetItemsProcessed(state.iterations() * static_cast<int64_t>(scans));
  state.counters["cpu_s"] =
      (ChildrenCpuSeconds() - cpu_before_s) / static_cast<double>(state.iterations());
}

// `side` x `side` copies of a drive, one after the other, side by side: a log of so many scans.
absl::StatusOr<size_t> WriteDrives(const std::string& carmen, int side,
                                   const Eigen::Vector2d& spacing_m, const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const CarmenLog drive,
                             ReadCarmenLog(carmen, std::nullopt, [](double) {}));
  const std::vector<Utime> times = RepairTimes(drive.scans, 10).utimes;
  const Utime pause = std::chrono::minutes(1);
  CarmenLog log;
  std::vector<Utime> utimes;
  for (int n = 0; n < side * side; ++n) {
    for (size_t k = 0; k < drive.scans.size(); ++k) {
      log.scans.push_back(drive.scans[k]);
      log.scans.back().world_T_laser.position_m +=
          Eigen::Vector2d(n % side, n / side).cwiseProduct(spacing_m);
      utimes.push_back(times[k] + n * (times.back() - times.front() + pause));
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(WriteAsLcmLog(log, utimes, path));
  return log.scans.size();
}

void RegisterDrives(const std::string& name, const std::string& carmen,
                    const Eigen::AlignedBox2d& bounds_m, int side) {
  const auto folder = std::make_shared<TemporaryDirectory>();
  const std::string log = folder->File("drive.lcmlog");
  const absl::StatusOr<size_t> scans = WriteDrives(carmen, side, bounds_m.sizes(), log);
  if (!scans.ok()) {
    std::fprintf(stderr, "end to end is left out: %s\n", scans.status().ToString().c_str());
    return;
  }
  const Eigen::Vector2d& min_m = bounds_m.min();
  const Eigen::Vector2d max_m = min_m + side * bounds_m.sizes();
  const std::pair<const char*, std::string> commands[] = {
      {"splinemap_build", fmt::format("'{}' build '{}' '{}' --force", SPLINEMAP_PROGRAM, log,
                                      folder->File("drive.splinemap"))},
      {"mrpt_build", fmt::format("'{}' '{}' {} {} {} {}", MRPT_PROGRAM, log, min_m.x(), max_m.x(),
                                 min_m.y(), max_m.y())}};
  for (const auto& [program, command] : commands) {
    benchmark::RegisterBenchmark(
        fmt::format("end_to_end/{}/{}", name, program).c_str(),
        [folder, command, scans = *scans](benchmark::State& state) { Run(state, command, scans); })
        ->UseRealTime();
  }
}

}  // namespace

void RegisterEndToEnd(const Workload& workload) {
  constexpr int kCampusSide = 3;
  std::string file = workload.name;
  std::replace(file.begin(), file.end(), '_', '-');
  const auto carmen = SharedData(fmt::format("carmen/{}-corrected.log.gz", file));
  if (!carmen) return;
  const Eigen::AlignedBox2d bounds_m = BoundsOf(workload);
  RegisterDrives(workload.name, *carmen, bounds_m, 1);
  if (workload.name == "freiburg_079") RegisterDrives("campus", *carmen, bounds_m, kCampusSide);
}

}  // namespace splinemap::bench
