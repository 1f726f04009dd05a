#pragma once

#include <cstdint>

namespace splinemap {

// 64 bits from the system's entropy source; never 0, which stands for "none" in files.
uint64_t RandomId();

}  // namespace splinemap
