#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "splinemap/beam_model_options.h"
#include "splinemap/posed_scan.h"

namespace splinemap {

// The beams of one scan and how they were mapped, packed: all of it but its time and pose. A record
// stands for itself, and gives back every bit.
std::string PackBeams(const PosedScan& scan, const BeamModelOptions& model);

struct UnpackedBeams {
  PosedScan scan;  // without time and pose
  BeamModelOptions model;
};
// Of any bytes. DataLoss where they cannot be.
absl::StatusOr<UnpackedBeams> UnpackBeams(absl::Span<const uint8_t> record);

}  // namespace splinemap
