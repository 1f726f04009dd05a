#include "lib/diagnosis/recording_sample.h"

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
// A scan waits for poses no longer than this.
constexpr Utime kMaxWait = milliseconds(5000);
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
  return bracket && bracket->after->utime - bracket->before->utime <= kMaxPoseGap &&
         !poses.IsInJump(utime) && !IsTiltedTooMuch(InterpolateUp(*bracket, utime));
}

RecordingSample SampleOf(const std::vector<RangeReadings>& scans, const PoseBuffer& poses,
                         Utime time_offset, size_t max_scans) {
  RecordingSample sample;
  sample.poses = poses;
  PlaceFilter places;
  for (const RangeReadings& readings : scans) {
    if (sample.scans.size() == max_scans) break;
    const Utime utime = readings.utime + time_offset;
    if (HasPosesAround(poses, utime) && places.IsNew(Interpolate(*poses.Find(utime), utime))) {
      sample.scans.push_back(readings);
    }
  }
  sample.turned_rad = places.turned_rad();
  return sample;
}

bool PlaceFilter::IsNew(const Pose2& world_T_robot) {
  if (last_) {
    const double moved_m = (world_T_robot.position_m - last_->position_m).norm();
    const double turned_rad = std::abs(WrapAngle(world_T_robot.yaw_rad - last_->yaw_rad));
    if (moved_m < kNewPlace_m && turned_rad < kNewPlace_rad) return false;
    turned_rad_ += turned_rad;
  }
  last_ = world_T_robot;
  return true;
}

void DriveCollector::AddPose(const TimedPose& pose) {
  if (full()) return;
  recent_.Add(pose);
  KeepScans();
}

void DriveCollector::AddScan(RangeReadings readings, Utime time_offset) {
  if (full()) return;
  waiting_.emplace_back(Thinned(std::move(readings), max_beams_), time_offset);
  if (waiting_.size() > kMaxWaiting) waiting_.pop_front();
  KeepScans();
}

void DriveCollector::KeepScans() {
  while (!waiting_.empty() && !full() && !recent_.empty()) {
    auto& [readings, time_offset] = waiting_.front();
    const Utime utime = readings.utime + time_offset;
    const bool is_of_another_clock = utime > recent_.newest() + kMaxWait;
    if (recent_.newest() < utime + kMargin && !is_of_another_clock) return;
    if (!is_of_another_clock) Keep(std::move(readings), utime);
    waiting_.pop_front();
  }
}

void DriveCollector::Keep(RangeReadings readings, Utime utime) {
  if (!HasPosesAround(recent_, utime)) return;
  if (!places_.IsNew(Interpolate(*recent_.Find(utime), utime))) return;
  sample_.turned_rad = places_.turned_rad();
  sample_.scans.push_back(std::move(readings));
  recent_.ForEach([&](const TimedPose& pose) {
    if (std::chrono::abs(pose.utime - utime) < 2 * kMargin) sample_.poses.Add(pose);
  });
}

}  // namespace splinemap
