#pragma once

#include "tests/bench/serving/figures.h"

namespace splinemap::bench {

// ms to answer what fills a message, over the most rugged surface: by itself, and in the requests
// into which clients have to cut it. A map of `tiles` x `tiles`.
Figures MeasureLargestRequests(int tiles);

}  // namespace splinemap::bench
