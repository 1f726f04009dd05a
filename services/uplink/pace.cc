#include "services/uplink/pace.h"

#include <algorithm>
#include <chrono>

namespace splinemap {

Clock::time_point Pace::Take(int64_t bytes, Clock::time_point now) {
  constexpr std::chrono::milliseconds kBurst(500);
  const Clock::time_point begin = std::max(free_, now);
  const std::chrono::duration<double> takes(static_cast<double>(bytes) / bytes_per_s_);
  free_ = begin + std::chrono::duration_cast<Clock::duration>(takes);
  return std::max(now, free_ - kBurst);
}

}  // namespace splinemap
