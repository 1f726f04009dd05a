#pragma once

#include <chrono>
#include <cstdint>

namespace splinemap {

// us since 1970, by the clock of this computer.
inline int64_t HostUtime() {
  return std::chrono::duration_cast<std::chrono::microseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

}  // namespace splinemap
