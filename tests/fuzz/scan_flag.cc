// What follows --scan on a command line.

#include "lib/config/config.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_scan_flag {

void Run(FuzzInput input) {
  const auto scan = ParseScanFlag(input.RestText());
  if (scan.ok()) SensorOptionsOf(*scan, scan->preset());
}

const FuzzTarget target("scan_flag", &Run);

}  // namespace splinemap::fuzz_scan_flag
