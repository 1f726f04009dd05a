#pragma once

#include "absl/status/statusor.h"
#include "tests/bench/serving/figures.h"

namespace splinemap::bench {

// ms from publishing a scan until all that it changed is in a replica's snapshot, through a daemon
// of its own on the bus of LCM_DEFAULT_URL; beside it an echo of the same scans by another process.
absl::StatusOr<Figures> MeasureLatency(int scans);

// The other process: sends back what it hears, for ever.
absl::Status Echo();

}  // namespace splinemap::bench
