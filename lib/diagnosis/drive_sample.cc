#include "lib/diagnosis/drive_sample.h"

#include <cmath>
#include <numbers>

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// Two scans of a sample are at least one of these apart.
constexpr double kNewPlace_m = 0.1;
constexpr double kNewPlace_rad = 3 * std::numbers::pi / 180;

constexpr Utime kMargin = milliseconds(1500);
constexpr Utime kMaxPoseGap = milliseconds(1000);
constexpr size_t kMaxWaiting = 1000;

}  // namespace

RangeReadings Thinned(RangeReadings readings, size_t max_beams) {
  const size_t step = (readings.ranges_m.size() + max_beams - 1) / max_beams;
  if (step <= 1) return readings;
  RangeReadings thin;
  thin.utime = readings.utime;
  for (size_t k = 0; k < readings.ranges_m.size(); k += step) {
    thin.ranges_m.push_back(readings.ranges_m[k]);
    thin.bearings_rad.push_back(readings.bearings_rad[k]);
    if (!readings.beam_utimes.empty()) thin.beam_utimes.push_back(readings.beam_utimes[k]);
  }
  return thin;
}

bool HasPosesAround(const PoseBuffer& poses, Utime utime) {
  if (poses.empty() || poses.oldest() > utime - kMargin || poses.newest() < utime + kMargin) {
    return false;
  }
  const auto bracket = poses.Find(utime);
  return bracket && bracket->after->utime - bracket->before->utime <= kMaxPoseGap;
}

void DriveCollector::AddPose(const TimedPose& pose) {
  if (full()) return;
  sample_.poses.Add(pose);
  KeepScans();
}

void DriveCollector::AddScan(RangeReadings readings, Utime time_offset) {
  if (full()) return;
  waiting_.emplace_back(Thinned(std::move(readings), max_beams_), time_offset);
  if (waiting_.size() > kMaxWaiting) waiting_.pop_front();
  KeepScans();
}

void DriveCollector::KeepScans() {
  const PoseBuffer& poses = sample_.poses;
  while (!waiting_.empty() && !full() && !poses.empty()) {
    auto& [readings, time_offset] = waiting_.front();
    const Utime utime = readings.utime + time_offset;
    if (poses.newest() < utime + kMargin) return;
    if (HasPosesAround(poses, utime) && IsNewPlace(Interpolate(*poses.Find(utime), utime))) {
      sample_.scans.push_back(std::move(readings));
    }
    waiting_.pop_front();
  }
}

bool DriveCollector::IsNewPlace(const Pose2& world_T_robot) {
  if (last_place_) {
    const double moved_m = (world_T_robot.position_m - last_place_->position_m).norm();
    const double turned_rad = std::abs(WrapAngle(world_T_robot.yaw_rad - last_place_->yaw_rad));
    if (moved_m < kNewPlace_m && turned_rad < kNewPlace_rad) return false;
    sample_.turned_rad += turned_rad;
  }
  last_place_ = world_T_robot;
  return true;
}

}  // namespace splinemap
