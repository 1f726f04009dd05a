#pragma once

#include <cstddef>
#include <vector>

namespace splinemap {

// The inner loop of UnitVectors(), compiled for one instruction set. All of them give the same
// bytes.
struct AngleKernel {
  const char* name;  // "plain", "avx2"

  // Sets units[2 * count] to those of angles within kMaxReduced_rad; `count` is a multiple of 4.
  void (*set_units)(const double* angles_rad, size_t count, double* units);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<AngleKernel>& AngleKernels();

}  // namespace splinemap
