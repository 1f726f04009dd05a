#include "lib/sensing/drop_counts.h"

namespace splinemap {
namespace {

struct Words {
  const char* name;
  const char* explanation;
};

Words WordsOf(DropReason reason) {
  switch (reason) {
    case DropReason::kWrongTypeOfScan:
      return {"wrong_type_of_scan", "a scan channel carries another type of message"};
    case DropReason::kWrongTypeOfPose:
      return {"wrong_type_of_pose", "the pose channel carries another type of message"};
    case DropReason::kMalformedScan:
      return {"malformed_scan", "the message cannot be decoded"};
    case DropReason::kUnusableScan:
      return {"unusable_scan", "the message does not fit the options of its channel"};
    case DropReason::kNoExtrinsics:
      return {"no_extrinsics", "no transform has come yet on the extrinsics_channel of the scans"};
    case DropReason::kDuplicateScan:
      return {"duplicate_scan", "a scan repeats the time stamp of an earlier one"};
    case DropReason::kLateScan:
      return {"late_scan", "a scan is older than one that is mapped already"};
    case DropReason::kScanWithoutPose:
      return {
          "scan_without_pose",
          "no poses before and after a scan (usual at start and end); if it goes on, do pose and "
          "scan channel share a clock?"};
    case DropReason::kScanInPoseGap:
      return {"scan_in_pose_gap",
              "the poses around a scan are too far apart; see timing { max_pose_gap_ms }"};
    case DropReason::kTiltedScan:
      return {"tilted_scan",
              "the pose tilts the robot by more than 10 degrees; if it is level, is the quaternion "
              "of the pose in the order w, x, y, z?"};
    case DropReason::kScanInPoseJump:
      return {"scan_in_pose_jump", "the poses around a scan are further apart than a robot moves"};
    case DropReason::kScanQueueFull:
      return {"scan_queue_full", "too many scans wait for poses"};
    case DropReason::kMalformedPose:
      return {"malformed_pose", "the message cannot be decoded"};
    case DropReason::kPoseOutOfRange:
      return {"pose_out_of_range", "a pose lies beyond what can be mapped"};
    case DropReason::kDuplicatePose:
      return {"duplicate_pose", "a pose repeats the time stamp of an earlier one, or is very late"};
    case DropReason::kMalformedExtrinsics:
      return {"malformed_extrinsics", "the transform of a sensor cannot be used"};
    case DropReason::kStoodStill:
      return {"stood_still", "the robot had moved less than min_travel_m and min_turn_deg"};
    case DropReason::kMapFull:
      return {"map_full", "the map has reached service { max_map_mb }"};
    case DropReason::kOverload:
      return {"overload", "messages come faster than they can be mapped"};
  }
  return {"unknown", ""};
}

}  // namespace

const char* DropName(DropReason reason) { return WordsOf(reason).name; }
const char* DropExplanation(DropReason reason) { return WordsOf(reason).explanation; }

}  // namespace splinemap
