// What follows --scan on a command line.

#include "lib/config/config.h"
#include "tests/fuzz/fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const auto scan = splinemap::ParseScanFlag({data, data + size});
  if (scan.ok()) splinemap::SensorOptionsOf(*scan, scan->preset());
  return 0;
}
