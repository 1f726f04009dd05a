#pragma once

#include <array>
#include <cstdint>
#include <numeric>

namespace splinemap {

// Why a message was not mapped.
enum class DropReason {
  kWrongTypeOfScan,      // another type of message on a scan channel
  kMalformedScan,        // cannot be decoded
  kUnusableScan,         // decoded, but of no use with the options of its channel
  kNoExtrinsics,         // came before the transform of its sensor
  kDuplicateScan,        // channel and time of an earlier one
  kLateScan,             // older than a scan that is mapped already
  kScanWithoutPose,      // never bracketed by poses
  kScanInPoseGap,        // bracketed by poses too far apart
  kTiltedScan,           // its robot was tilted by more than 10 degrees
  kScanInPoseJump,       // bracketed by poses between which no robot can have moved
  kScanQueueFull,        // the oldest, when too many wait for poses
  kWrongTypeOfPose,      // another type of message on the pose channel
  kMalformedPose,        // cannot be decoded
  kPoseOutOfRange,       // beyond the coordinates that control points exist for
  kDuplicatePose,        // time of an earlier one, or too old to keep
  kMalformedExtrinsics,  // cannot be used, or of another type
  kStoodStill,           // the motion filter
  kMapFull,              // the map has its greatest size
  kOverload,             // received faster than mapped; voids that equal input gives equal maps
};
inline constexpr int kNumDropReasons = static_cast<int>(DropReason::kOverload) + 1;

// As in status messages: "scan_without_pose".
const char* DropName(DropReason reason);
// What it means and what to do, for people.
const char* DropExplanation(DropReason reason);

// Totals by reason.
class DropCounts {
 public:
  int64_t& operator[](DropReason reason) { return counts_[static_cast<int>(reason)]; }
  int64_t operator[](DropReason reason) const { return counts_[static_cast<int>(reason)]; }
  int64_t Total() const { return std::accumulate(counts_.begin(), counts_.end(), int64_t{0}); }
  DropCounts& operator+=(const DropCounts& other) {
    for (int k = 0; k < kNumDropReasons; ++k) counts_[k] += other.counts_[k];
    return *this;
  }

 private:
  std::array<int64_t, kNumDropReasons> counts_{};
};

}  // namespace splinemap
