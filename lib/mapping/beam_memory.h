#pragma once

#include <cstddef>

#include "absl/types/span.h"
#include "lib/mapping/scan_kernel.h"
#include "splinemap/scan.h"

namespace splinemap {

// Beams as kernels see them.
inline const BeamMemory* MemoryOf(absl::Span<const PlacedBeam> beams) {
  static_assert(sizeof(PlacedBeam) == sizeof(BeamMemory));
  static_assert(offsetof(PlacedBeam, direction_world) == offsetof(BeamMemory, direction_world));
  static_assert(offsetof(PlacedBeam, range_m) == offsetof(BeamMemory, range_m));
  return reinterpret_cast<const BeamMemory*>(beams.data());
}

}  // namespace splinemap
