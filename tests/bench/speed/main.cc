// Times splinemap, its peers and what limits it. tests/bench/run.sh makes a report of it.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

#include "tests/bench/speed/benchmarks.h"

namespace {

// Takes `flag` out of the arguments and says whether it was there.
bool Take(const std::string& flag, std::vector<char*>& arguments) {
  return std::erase_if(arguments, [&](const char* argument) { return argument == flag; }) > 0;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace splinemap::bench;
  std::vector<char*> arguments(argv, argv + argc);
  const bool quick = Take("--quick", arguments);
  int count = static_cast<int>(arguments.size());
  arguments.push_back(nullptr);
  benchmark::Initialize(&count, arguments.data());
  if (benchmark::ReportUnrecognizedArguments(count, arguments.data())) return 2;

  if (quick) benchmark::AddCustomContext("quick", "yes");

  const std::vector<Workload> workloads =
      MakeWorkloads(quick ? 40 : std::numeric_limits<int>::max());
  RegisterInsertion(workloads);
  RegisterPeers(workloads);
  RegisterLimit(workloads);
  RegisterQueries(quick ? 1'000 : 100'000);
  RegisterMerging(quick ? 256 : 8'192);
  RegisterGrowth(workloads.back(), quick ? 1'000 : 400'000);
  RegisterEndToEnd();
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
