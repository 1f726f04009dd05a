// The beams of a scan, as they are sent and kept.

#include "lib/archive/scan_record.h"

#include "tests/fuzz/fuzz.h"

namespace splinemap::fuzz_scan_record {

void Run(FuzzInput input) {
  const auto unpacked = UnpackBeams(input.Rest());
  if (!unpacked.ok()) return;
  const std::string record = PackBeams(unpacked->scan, unpacked->model);
  const auto again = UnpackBeams({reinterpret_cast<const uint8_t*>(record.data()), record.size()});
  Require(again.ok() && again->model == unpacked->model &&
              again->scan.robot_T_sensor == unpacked->scan.robot_T_sensor &&
              PackBeams(again->scan, again->model) == record,
          "a scan that is packed again is the same");
}

const FuzzTarget target("scan_record", &Run);

}  // namespace splinemap::fuzz_scan_record
