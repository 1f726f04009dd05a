#pragma once

#include <cstddef>
#include <vector>

#include "splinemap/tile.h"

namespace splinemap {

// The inner loop of SumTiles(), compiled for one instruction set. All of them give the same bytes.
struct SumKernel {
  const char* name;  // "plain", "avx2", "avx512", "neon"

  // Tiles by their control points; null ones are zeros. Sets sum[Tile::kSize].
  void (*sum)(const ControlPoint* const* tiles, size_t count, ControlLimits limits,
              ControlPoint* sum);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<SumKernel>& SumKernels();

}  // namespace splinemap
