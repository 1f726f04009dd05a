// An LCM log, plain or gzip.

#include "lib/logs/lcm_log.h"

#include "tests/fuzz/fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static splinemap::MemoryFile file;
  file.Set({data, size});
  constexpr size_t kHeaderBytes = 28;
  size_t bytes = 0;
  splinemap::ReadLcmLog(
      file.path(),
      [&](const splinemap::LogEvent& event) {
        bytes += kHeaderBytes + event.channel.size() + event.message.size();
      },
      [](double share) { splinemap::Require(share >= 0, "progress is a share"); })
      .IgnoreError();
  const bool is_gzip = size > 1 && data[0] == 0x1f && data[1] == 0x8b;
  splinemap::Require(is_gzip || bytes <= size, "no byte of a log is read twice");
  return 0;
}
