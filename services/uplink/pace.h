#pragma once

#include <cstdint>
#include <functional>

#include "lib/base/clock.h"

namespace splinemap {

// How fast a link may be filled: so many bytes a second in the mean, and half a second's at once.
// Thread-compatible.
class Pace {
 public:
  explicit Pace(double bytes_per_s) : bytes_per_s_(bytes_per_s) {}

  // When so many bytes may be sent, which are counted as sent then.
  Clock::time_point Take(int64_t bytes, Clock::time_point now);

 private:
  const double bytes_per_s_;
  Clock::time_point free_;  // when all that was sent has gone
};

}  // namespace splinemap
