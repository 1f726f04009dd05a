#pragma once

#include <functional>
#include <memory>
#include <optional>

#include "absl/status/statusor.h"
#include "splinemap/scan_archive.h"
#include "splinemap/trajectory.h"

namespace splinemap {

// What makes another archive of one: its scans left out, moved, placed. It says the same of scans
// that come while it is folded.
struct ArchiveEdit {
  std::function<bool(const ScanPose&)> is_kept;     // none: all are
  std::function<FixedPose2(const ScanPose&)> move;  // none: they stay
  std::optional<FixedPose2> map_T_world;            // none: as it was
  bool keeps_base = true;

  ScanArchive Apply(const ScanArchive& archive) const;
  // Whether that is another one.
  bool Changes(const ScanArchive& archive) const;
  // A later scan, or null.
  std::shared_ptr<const PosedScan> ApplyTo(const PosedScan& scan) const;
};

// Leaves out all scans before `utime`: the map is that of the scans since. FailedPrecondition where
// scans since then are in the base, which cannot be divided.
absl::StatusOr<ArchiveEdit> ForgetBefore(const ScanArchive& archive, Utime utime);

// Leaves out all scans after `utime`: the map as it was then. FailedPrecondition where the base has
// some.
absl::StatusOr<ArchiveEdit> WindBackTo(const ScanArchive& archive, Utime utime);

// InvalidArgument where stamps do not increase or poses are not finite or too far out, or for fewer
// than one pose.
absl::Status CheckTrajectory(const Trajectory& trajectory);

// Moves scans to a trajectory: one at the time of a pose gets that pose; one between two moves with
// both, the nearer in time the more. What is before the first pose stays. Requires
// CheckTrajectory(). FailedPrecondition where scans of its time are in the base, which cannot be
// moved; NotFound where no scan is of its time.
absl::StatusOr<ArchiveEdit> CorrectBy(const ScanArchive& archive, const Trajectory& trajectory);

}  // namespace splinemap
