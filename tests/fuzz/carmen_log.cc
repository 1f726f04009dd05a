// A CARMEN log, plain or gzip, and the repair of its times.

#include "lib/logs/carmen_log.h"

#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_carmen_log {

void Run(FuzzInput input) {
  static MemoryFile file;
  file.Set(input.Rest());
  const auto log = ReadCarmenLog(file.path(), std::nullopt, [](double) {});
  if (!log.ok()) return;
  const RepairedTimes times = RepairTimes(log->scans, 10);
  for (size_t k = 1; k < times.utimes.size(); ++k) {
    Require(times.utimes[k - 1] < times.utimes[k], "repaired times increase");
  }
}

const FuzzTarget target("carmen_log", &Run);

}  // namespace splinemap::fuzz_carmen_log
