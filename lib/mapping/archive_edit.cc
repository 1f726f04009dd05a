#include "lib/mapping/archive_edit.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "lib/base/status.h"
#include "lib/mapping/fold.h"

namespace splinemap {
namespace {

// Whether the base has nothing from `utime` on. Where nobody knows how old it is, it is older than
// the scans that were mapped onto it.
bool BaseEndsBefore(const ScanArchive& archive, Utime utime) {
  const ScanArchive::Base& base = archive.base;
  if (base.IsEmpty()) return true;
  if (base.newest != Utime(0)) return base.newest < utime;
  Utime first = Utime::max();
  archive.ForEachPose([&](const ScanPose& pose) { first = std::min(first, pose.utime); });
  return utime >= first;
}

bool IsEarlier(const ScanPose& a, const ScanPose& b) { return a.utime < b.utime; }

// Where scans were by their poses, in between and at the ends of time.
class Path {
 public:
  explicit Path(const ScanArchive& archive) {
    archive.ForEachPose([&](const ScanPose& pose) { poses_.push_back(pose); });
    std::stable_sort(poses_.begin(), poses_.end(), IsEarlier);
  }

  bool IsEmpty() const { return poses_.empty(); }
  Utime first() const { return poses_.front().utime; }
  Utime last() const { return poses_.back().utime; }

  // Nothing beyond the first and the last scan.
  std::optional<Pose2> At(Utime utime) const {
    const auto after =
        std::lower_bound(poses_.begin(), poses_.end(), ScanPose{utime, {}}, IsEarlier);
    if (after == poses_.end()) return std::nullopt;
    const Pose2 to = after->world_T_robot.ToPose();
    if (after->utime == utime) return to;
    if (after == poses_.begin()) return std::nullopt;
    const auto before = std::prev(after);
    const double passed = static_cast<double>((utime - before->utime).count()) /
                          static_cast<double>((after->utime - before->utime).count());
    return Interpolate(before->world_T_robot.ToPose(), to, passed);
  }

 private:
  std::vector<ScanPose> poses_;
};

// A pose of the trajectory, and where the robot was thought to be then.
struct Anchor {
  Utime utime;
  Pose2 right;
  std::optional<Pose2> before;

  // Where a pose goes that moves with this one.
  std::optional<Pose2> Move(const Pose2& pose) const {
    if (!before) return std::nullopt;
    return right * (Inverse(*before) * pose);
  }
};

class Correction {
 public:
  Correction(const Path& path, const Trajectory& trajectory) : until_(trajectory.until) {
    for (const TrajectoryPose& pose : trajectory.poses) {
      anchors_.push_back({pose.utime, pose.world_T_robot, path.At(pose.utime)});
    }
  }

  FixedPose2 Move(const ScanPose& scan) const {
    const auto after =
        std::lower_bound(anchors_.begin(), anchors_.end(), scan.utime,
                         [](const Anchor& anchor, Utime utime) { return anchor.utime < utime; });
    if (after != anchors_.end() && after->utime == scan.utime)
      return FixedPose2::Nearest(after->right);
    if (after == anchors_.begin()) return scan.world_T_robot;
    const Pose2 pose = scan.world_T_robot.ToPose();
    const Anchor& before = *std::prev(after);
    if (after == anchors_.end()) {
      const auto moved = before.Move(pose);
      return moved && scan.utime < until_ ? FixedPose2::Nearest(*moved) : scan.world_T_robot;
    }
    const double passed = static_cast<double>((scan.utime - before.utime).count()) /
                          static_cast<double>((after->utime - before.utime).count());
    const auto from = before.Move(pose);
    const auto to = after->Move(pose);
    if (from && to) return FixedPose2::Nearest(Interpolate(*from, *to, passed));
    if (from || to) return FixedPose2::Nearest(from ? *from : *to);
    return FixedPose2::Nearest(Interpolate(before.right, after->right, passed));
  }

 private:
  std::vector<Anchor> anchors_;
  const Utime until_;
};

}  // namespace

ScanArchive ArchiveEdit::Apply(const ScanArchive& archive) const {
  ScanArchive result = is_kept ? archive.Filtered(is_kept) : archive;
  if (move) result = result.Moved(move);
  if (map_T_world) result.map_T_world = *map_T_world;
  if (!keeps_base) result.base = {};
  return result;
}

bool ArchiveEdit::Changes(const ScanArchive& archive) const {
  bool changes = (map_T_world && *map_T_world != archive.map_T_world) ||
                 (!keeps_base && !archive.base.IsEmpty());
  archive.ForEachPose([&](const ScanPose& pose) {
    changes = changes || (is_kept && !is_kept(pose)) || (move && move(pose) != pose.world_T_robot);
  });
  return changes;
}

std::shared_ptr<const PosedScan> ArchiveEdit::ApplyTo(const PosedScan& scan) const {
  const ScanPose pose{scan.utime, scan.world_T_robot};
  if (is_kept && !is_kept(pose)) return nullptr;
  auto result = std::make_shared<PosedScan>(scan);
  if (move) result->world_T_robot = move(pose);
  return result;
}

absl::StatusOr<ArchiveEdit> ForgetBefore(const ScanArchive& archive, Utime utime) {
  if (!BaseEndsBefore(archive, utime)) {
    return FailedPrecondition("{} and some of them may be later than that", NotKept(archive));
  }
  ArchiveEdit edit;
  edit.is_kept = [utime](const ScanPose& pose) { return pose.utime >= utime; };
  edit.keeps_base = false;
  return edit;
}

absl::StatusOr<ArchiveEdit> WindBackTo(const ScanArchive& archive, Utime utime) {
  if (!BaseEndsBefore(archive, std::min(utime, Utime::max() - Utime(1)) + Utime(1))) {
    return FailedPrecondition("{} so it cannot be wound back to then", NotKept(archive));
  }
  ArchiveEdit edit;
  edit.is_kept = [utime](const ScanPose& pose) { return pose.utime <= utime; };
  return edit;
}

absl::Status CheckTrajectory(const Trajectory& trajectory) {
  if (trajectory.poses.empty()) return InvalidArgument("a trajectory without a pose");
  for (size_t k = 0; k < trajectory.poses.size(); ++k) {
    const auto& [utime, pose] = trajectory.poses[k];
    if (k > 0 && utime <= trajectory.poses[k - 1].utime) {
      return InvalidArgument(
          "pose {} of the trajectory is stamped {}, and the one before it {}; "
          "stamps have to increase",
          k, utime.count(), trajectory.poses[k - 1].utime.count());
    }
    if (!FixedPose2::IsInRange(pose)) {
      return InvalidArgument("pose {} of the trajectory is not finite or too far out", k);
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<ArchiveEdit> CorrectBy(const ScanArchive& archive, const Trajectory& trajectory) {
  const Utime first = trajectory.poses.front().utime;
  if (!BaseEndsBefore(archive, first)) {
    return FailedPrecondition("{} and some of them may be of the time of the trajectory",
                              NotKept(archive));
  }
  const Path path(archive);
  if (path.IsEmpty() || first > path.last() ||
      std::max(trajectory.poses.back().utime, trajectory.until) < path.first()) {
    return NotFound(
        "no scan is of the time of the trajectory, {} to {} us{}; is it on the clock of the scans?",
        first.count(), trajectory.poses.back().utime.count(),
        path.IsEmpty()
            ? ""
            : fmt::format("; scans are of {} to {} us", path.first().count(), path.last().count()));
  }
  ArchiveEdit edit;
  edit.move = [correction = std::make_shared<Correction>(path, trajectory)](const ScanPose& pose) {
    return correction->Move(pose);
  };
  return edit;
}

}  // namespace splinemap
