#pragma once

#include "tests/bench/serving/figures.h"
#include "tests/bench/speed/workload.h"

namespace splinemap::bench {

// kB a second that a daemon with defaults publishes of a drive of 10 scans a second, without losses
// and late joiners, and what the same map costs as an occupancy grid. In virtual time.
Figures MeasureBandwidth(const Workload& workload);

}  // namespace splinemap::bench
