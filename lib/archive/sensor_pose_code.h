#pragma once

#include <cstddef>
#include <vector>

#include "lib/archive/bit_stream.h"
#include "splinemap/fixed_pose2.h"

namespace splinemap {

// Poses of the sensor for each beam of a scan, or of all. Requires valid ones. False where they
// cannot be; `count` of them are allocated.
void PutSensorPoses(const std::vector<FixedPose2>& poses, BitWriter& writer);
bool TakeSensorPoses(size_t count, BitReader& reader, std::vector<FixedPose2>& poses);

}  // namespace splinemap
