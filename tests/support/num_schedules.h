#pragma once

#include <cstdlib>

namespace splinemap {

// How many random schedules a test runs. Thousands by hand: SPLINEMAP_SCHEDULES=500.
inline int NumSchedules(int usual) {
  const char* wanted = std::getenv("SPLINEMAP_SCHEDULES");
  return wanted != nullptr ? std::atoi(wanted) : usual;
}

}  // namespace splinemap
