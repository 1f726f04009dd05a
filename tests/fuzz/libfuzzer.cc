// Where libFuzzer enters: the target FUZZ_TARGET.

#include "tests/fuzz/fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const splinemap::FuzzRun run = splinemap::FindFuzzTarget(FUZZ_TARGET);
  run({data, size});
  return 0;
}
