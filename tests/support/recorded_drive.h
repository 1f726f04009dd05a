#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/pose2.h"
#include "splinemap/posed_scan.h"
#include "splinemap/scan.h"

namespace splinemap {

struct RecordedScan {
  Scan scan;
  Pose2 world_T_sensor;
};

// The scans of a CARMEN log, each with its corrected pose, in the order of the log.
absl::StatusOr<std::vector<RecordedScan>> ReadRecordedDrive(const std::string& path,
                                                            const SensorOptions& options);

// As daemons keep it.
PosedScan PosedScanOf(const RecordedScan& recorded);

// All beams from one pose.
std::vector<PlacedBeam> Place(const RecordedScan& recorded);

}  // namespace splinemap
