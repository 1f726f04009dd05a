// The command line program over a whole recorded drive: reading the log, mapping, saving.
#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>

#include "fmt/format.h"
#include "tests/bench/speed/benchmarks.h"
#include "tests/support/shared_data.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::bench {
namespace {

bool Run(const std::string& arguments) {
  return std::system(
             fmt::format("'{}' {} > /dev/null 2>&1", SPLINEMAP_PROGRAM, arguments).c_str()) == 0;
}

double Seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

double ChildrenCpuSeconds() {
  rusage usage;
  getrusage(RUSAGE_CHILDREN, &usage);
  return Seconds(usage.ru_utime) + Seconds(usage.ru_stime);
}

void Build(benchmark::State& state, const std::string& log, const std::string& out, int64_t scans) {
  const double cpu_before_s = ChildrenCpuSeconds();
  for (auto _ : state) {
    if (!Run(fmt::format("build '{}' '{}' --force --scan LASER --pose POSE", log, out))) {
      state.SkipWithError("splinemap build failed");
      return;
    }
  }
  state.SetItemsProcessed(state.iterations() * scans);
  state.counters["cpu_s"] =
      (ChildrenCpuSeconds() - cpu_before_s) / static_cast<double>(state.iterations());
}

}  // namespace

void RegisterEndToEnd() {
  const auto carmen = SharedData("carmen/freiburg-079-corrected.log.gz");
  if (!carmen) return;
  const auto drive = ReadRecordedDrive(*carmen, {});
  if (!drive.ok()) return;
  const auto folder = std::make_shared<TemporaryDirectory>();
  const std::string log = folder->File("freiburg_079.lcmlog");
  if (!Run(fmt::format("import-carmen '{}' '{}'", *carmen, log))) {
    std::fprintf(stderr, "end to end is left out: %s failed\n", SPLINEMAP_PROGRAM);
    return;
  }
  benchmark::RegisterBenchmark("end_to_end/freiburg_079/splinemap_build",
                               [folder, log, scans = drive->size()](benchmark::State& state) {
                                 Build(state, log, folder->File("freiburg_079.splinemap"),
                                       static_cast<int64_t>(scans));
                               })
      ->UseRealTime();
}

}  // namespace splinemap::bench
