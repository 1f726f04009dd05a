#pragma once

#include <optional>
#include <string>
#include <vector>

#include "splinemap/scan_archive.h"

namespace splinemap {

// Whether this is how the beams of a block were kept before scans had records: zstd of planes of
// bytes.
bool IsEarlierBlock(const std::string& beams);

struct EarlierBlock {
  BeamModelOptions model;
  PosedScans scans;
};
// Nothing where the bytes cannot be, or have not one scan for each pose.
std::optional<EarlierBlock> UnpackEarlierBlock(const std::string& beams,
                                               const std::vector<ScanPose>& poses);

}  // namespace splinemap
