// Times splinemap, its peers and what limits it. tests/bench/run.sh makes a report of it.
#include <benchmark/benchmark.h>

#include <cstdio>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "lib/mapping/scan_kernel.h"
#include "tests/bench/speed/benchmarks.h"

namespace splinemap::bench {
namespace {

constexpr const char* kUsage =
    "usage: speed insertion/WORKLOAD|queries|merging|growth [--quick] [--benchmark_..]\n"
    "One subject a process: memory that others have used and freed slows OctoMap to a half.\n";

constexpr int kQuickScans = 40;

// False where the workload is not there.
bool RegisterAllInsertion(const std::string& name, bool quick, std::optional<Workload>& workload) {
  workload = MakeWorkload(name, quick ? kQuickScans : std::numeric_limits<int>::max());
  if (!workload) return false;
  RegisterInsertion(*workload);
  RegisterPeers(*workload);
  RegisterLimit(*workload);
  RegisterEndToEnd(*workload);
  return true;
}

// False for a subject that there is not. `workload` outlives the run.
bool Register(const std::string& subject, bool quick, std::optional<Workload>& workload) {
  constexpr std::string_view kInsertion = "insertion/";
  if (subject.starts_with(kInsertion)) {
    return RegisterAllInsertion(subject.substr(kInsertion.size()), quick, workload);
  }
  if (subject == "queries") {
    RegisterQueries(quick ? 1'000 : 100'000);
  } else if (subject == "merging") {
    RegisterMerging(quick ? 256 : 8'192);
  } else if (subject == "growth") {
    workload = MakeWorkload("simulated_360_beams_3.5_m", quick ? kQuickScans : 500);
    RegisterGrowth(*workload, quick ? 1'000 : 400'000);
  } else {
    return false;
  }
  return true;
}

int Main(int argc, char** argv) {
  std::vector<char*> arguments(argv, argv + argc);
  const bool quick =
      std::erase_if(arguments, [](const char* a) { return std::string_view(a) == "--quick"; }) > 0;
  int count = static_cast<int>(arguments.size());
  arguments.push_back(nullptr);
  benchmark::Initialize(&count, arguments.data());
  std::optional<Workload> workload;
  if (count != 2 || !Register(arguments[1], quick, workload)) {
    std::fputs(kUsage, stderr);
    return 2;
  }
  benchmark::AddCustomContext("instructions", FastestScanKernel().name);
  if (quick) benchmark::AddCustomContext("quick", "yes");
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}

}  // namespace
}  // namespace splinemap::bench

int main(int argc, char** argv) { return splinemap::bench::Main(argc, argv); }
