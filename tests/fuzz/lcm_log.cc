// An LCM log, plain or gzip.

#include "lib/logs/lcm_log.h"

#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_lcm_log {

void Run(FuzzInput input) {
  static MemoryFile file;
  const absl::Span<const uint8_t> content = input.Rest();
  file.Set(content);
  constexpr size_t kHeaderBytes = 28;
  size_t bytes = 0;
  ReadLcmLog(
      file.path(),
      [&](const LogEvent& event) {
        bytes += kHeaderBytes + event.channel.size() + event.message.size();
      },
      [](double share) { Require(share >= 0, "progress is a share"); })
      .IgnoreError();
  const bool is_gzip = content.size() > 1 && content[0] == 0x1f && content[1] == 0x8b;
  Require(is_gzip || bytes <= content.size(), "no byte of a log is read twice");
}

const FuzzTarget target("lcm_log", &Run);

}  // namespace splinemap::fuzz_lcm_log
