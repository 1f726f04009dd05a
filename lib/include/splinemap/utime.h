#pragma once

#include <chrono>

namespace splinemap {

// A message's time stamp: microseconds since the epoch of whoever wrote it (mostly 1970, on some
// robots the start of the computer). Stamps of one clock may be compared, nothing else.
using Utime = std::chrono::microseconds;

}  // namespace splinemap
