// A CARMEN log, plain or gzip, and the repair of its times.

#include "lib/logs/carmen_log.h"

#include "tests/fuzz/fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static splinemap::MemoryFile file;
  file.Set({data, size});
  const auto log = splinemap::ReadCarmenLog(file.path(), [](double) {});
  if (!log.ok()) return 0;
  const splinemap::RepairedTimes times = splinemap::RepairTimes(log->scans, 10);
  for (size_t k = 1; k < times.utimes.size(); ++k) {
    splinemap::Require(times.utimes[k - 1] < times.utimes[k], "repaired times increase");
  }
  return 0;
}
