#pragma once

#include <chrono>

namespace splinemap {

// Time that passes; it is never set back. What messages are stamped with is Utime.
using Clock = std::chrono::steady_clock;

}  // namespace splinemap
