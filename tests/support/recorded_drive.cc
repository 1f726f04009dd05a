#include "tests/support/recorded_drive.h"

#include "lib/base/status.h"
#include "lib/logs/carmen_log.h"

namespace splinemap {

absl::StatusOr<std::vector<RecordedScan>> ReadRecordedDrive(const std::string& path,
                                                            const SensorOptions& options) {
  SPLINEMAP_ASSIGN_OR_RETURN(CarmenLog log, ReadCarmenLog(path, std::nullopt, [](double) {}));
  std::vector<RecordedScan> drive;
  for (CarmenScan& carmen : log.scans) {
    RangeReadings readings;
    for (size_t k = 0; k < carmen.ranges_m.size(); ++k) {
      readings.bearings_rad.push_back(static_cast<float>(
          carmen.first_bearing_rad + static_cast<double>(k) * carmen.bearing_step_rad));
    }
    readings.ranges_m = std::move(carmen.ranges_m);
    SPLINEMAP_ASSIGN_OR_RETURN(Scan scan, PrepareScan(readings, options, 0));
    drive.push_back({std::move(scan), carmen.world_T_laser});
  }
  return drive;
}

PosedScan PosedScanOf(const RecordedScan& recorded) {
  PosedScan scan;
  scan.utime = recorded.scan.utime;
  scan.world_T_robot = FixedPose2::Nearest(recorded.world_T_sensor);
  scan.robot_T_sensor = {FixedPose2()};
  scan.beams = recorded.scan.beams;
  return scan;
}

std::vector<PlacedBeam> Place(const RecordedScan& recorded) {
  std::vector<PlacedBeam> beams;
  Place(recorded.scan.beams, {&recorded.world_T_sensor, 1}, beams);
  return beams;
}

}  // namespace splinemap
