#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "tests/bench/serving/figures.h"

namespace splinemap::bench {

// ms from publishing a scan until all that it changed is in a replica's view, through a daemon
// of its own on the bus of LCM_DEFAULT_URL; beside it an echo of the same scans by another process.
absl::StatusOr<Figures> MeasureLatency(int scans);

// ms until a daemon has answered queries of points; beside them an echo of as many bytes in as many
// messages by another process.
absl::StatusOr<std::vector<Figures>> MeasureAsking(int repetitions);

// The other process: sends back what it hears, for ever.
absl::Status Echo();

}  // namespace splinemap::bench
