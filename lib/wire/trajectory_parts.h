#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "splinemap/trajectory.h"

namespace splinemap {

// What the signature of a part is of, in place of the channel: with it, a part that was recorded is
// of no use to another process of the daemon.
std::string TrajectorySigning(const std::string& channel_prefix, uint64_t daemon_nonce);

// Puts trajectories together from their parts, which come in any order. Thread-compatible.
class TrajectoryParts {
 public:
  static constexpr int kMaxParts = 1000;
  static constexpr size_t kMaxPoses = 1'000'000;

  // For whom it collects.
  explicit TrajectoryParts(std::string robot) : robot_(std::move(robot)) {}

  // A trajectory_t; the trajectory when that is its last part to come, nothing for one of another
  // robot. A part of another trajectory drops those that are not whole. InvalidArgument in words.
  absl::StatusOr<std::optional<Trajectory>> Add(absl::Span<const uint8_t> message);

 private:
  const std::string robot_;
  int64_t utime_ = -1;
  int num_parts_ = 0;
  size_t num_poses_ = 0;
  std::map<int, std::vector<TrajectoryPose>> parts_;
};

}  // namespace splinemap
