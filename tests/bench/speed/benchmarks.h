#pragma once

#include "tests/bench/speed/workload.h"

namespace splinemap::bench {

// Each registers benchmarks whose names are SUBJECT/WORKLOAD/COMPETITOR and whose items are those
// of the subject: scans, points, tiles. The workload outlives the run.

// Scans into a fresh map: splinemap.
void RegisterInsertion(const Workload& workload);
// The same: MRPT, OctoMap, the paper's update.
void RegisterPeers(const Workload& workload);
// The same: reading, adding to and writing what scans change, and nothing else.
void RegisterLimit(const Workload& workload);
// Points of a large map.
void RegisterQueries(size_t num_tiles);
// The sum of eight layers.
void RegisterMerging(size_t num_tiles);
// Scans and snapshots in maps of growing size.
void RegisterGrowth(const Workload& workload, size_t max_tiles);
// Whole processes over the log of a recorded drive, and of the same drive nine times, a campus.
void RegisterEndToEnd(const Workload& workload);

}  // namespace splinemap::bench
