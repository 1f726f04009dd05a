#include "lib/sensing/scan_queue.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace splinemap {
namespace {

template <typename Message>
std::optional<Utime> UtimeOf(const std::optional<Message>& message) {
  return message ? std::optional(message->utime) : std::nullopt;
}

}  // namespace

ScanQueue::ScanQueue(ScanQueueOptions options, int num_channels)
    : options_(options),
      poses_(options.pose_history),
      newest_scan_(num_channels),
      held_scans_(num_channels) {
  counts_.without_pose_in_a_row.resize(num_channels);
}

void ScanQueue::AddPose(const TimedPose& pose) {
  const Step step = StepOf(poses_.empty() ? std::nullopt : std::optional(poses_.newest()),
                           UtimeOf(held_pose_), pose.utime);
  if (step == Step::kRewound) BeginAnew(std::nullopt);
  DropHeldPose();
  if (step == Step::kBack) {
    held_pose_ = pose;
  } else {
    HandlePose(pose);
  }
}

void ScanQueue::AddScan(Scan scan) {
  const int channel = scan.channel;
  std::optional<Scan>& held = held_scans_[channel];
  const Step step = StepOf(newest_scan_[channel], UtimeOf(held), scan.utime);
  if (step == Step::kRewound) BeginAnew(channel);
  DropHeldScan(channel);
  if (step == Step::kBack) {
    held = std::move(scan);
  } else {
    HandleScan(std::move(scan));
  }
}

void ScanQueue::Flush() {
  DropHeld();
  Drain(true);
  poses_.Clear();
  last_placed_.reset();
  std::fill(newest_scan_.begin(), newest_scan_.end(), std::nullopt);
}

size_t ScanQueue::size() const {
  return waiting_.size() + std::count_if(held_scans_.begin(), held_scans_.end(),
                                         [](const auto& held) { return held.has_value(); });
}

std::optional<PlacedScan> ScanQueue::Next() {
  if (ready_.empty()) return std::nullopt;
  PlacedScan scan = std::move(ready_.front());
  ready_.pop_front();
  return scan;
}

ScanQueue::Step ScanQueue::StepOf(std::optional<Utime> newest, std::optional<Utime> held,
                                  Utime utime) const {
  if (!newest || utime >= *newest - options_.time_jump) return Step::kOn;
  // The same message twice is no second one.
  const bool goes_on_from_held = held && utime != *held && utime >= *held - options_.time_jump;
  return goes_on_from_held ? Step::kRewound : Step::kBack;
}

// What was held is of the new time.
void ScanQueue::BeginAnew(std::optional<int> jumped_channel) {
  ++counts_.time_jumps;
  counts_.jumped_channel = jumped_channel;
  const std::optional<TimedPose> pose = std::exchange(held_pose_, std::nullopt);
  std::vector<std::optional<Scan>> scans(held_scans_.size());
  std::swap(scans, held_scans_);
  Flush();
  if (pose) HandlePose(*pose);
  for (std::optional<Scan>& scan : scans) {
    if (scan) HandleScan(*std::move(scan));
  }
}

void ScanQueue::DropHeld() {
  DropHeldPose();
  for (size_t k = 0; k < held_scans_.size(); ++k) DropHeldScan(static_cast<int>(k));
}

void ScanQueue::DropHeldPose() {
  if (held_pose_) ++counts_.drops[DropReason::kDuplicatePose];
  held_pose_.reset();
}

void ScanQueue::DropHeldScan(int channel) {
  if (held_scans_[channel]) ++counts_.drops[DropReason::kLateScan];
  held_scans_[channel].reset();
}

void ScanQueue::HandlePose(const TimedPose& pose) {
  if (!poses_.Add(pose)) ++counts_.drops[DropReason::kDuplicatePose];
  if (last_pose_ && last_pose_->utime < pose.utime && IsJump(*last_pose_, pose)) {
    ++counts_.pose_jumps;
    counts_.last_pose_jump = {*last_pose_, pose};
  }
  last_pose_ = pose;
  Drain(false);
}

void ScanQueue::HandleScan(Scan scan) {
  std::optional<Utime>& newest = newest_scan_[scan.channel];
  const Key key{scan.utime, scan.channel};
  if (newest == scan.utime || waiting_.contains(key)) {
    ++counts_.drops[DropReason::kDuplicateScan];
    return;
  }
  newest = std::max(newest.value_or(scan.utime), scan.utime);
  if (last_placed_ && key <= *last_placed_) {
    // A clock that is far behind is worth other words than a message that came late.
    if (poses_.empty() || scan.utime < poses_.oldest()) {
      CountWithoutPose(scan);
    } else {
      ++counts_.drops[DropReason::kLateScan];
    }
  } else {
    beams_waiting_ += scan.beams.size();
    waiting_.emplace(key, std::move(scan));
  }
  Drain(false);
  while (waiting_.size() > kMaxScans || beams_waiting_ > kMaxBeamsWaiting) {
    ++counts_.drops[DropReason::kScanQueueFull];
    DropOldest();
  }
}

ScanQueue::Fate ScanQueue::Judge(const Scan& scan) const {
  const Utime first = scan.utime + scan.first_beam;
  const Utime last = scan.utime + scan.last_beam;
  if (!poses_.empty() && poses_.newest() >= last) {
    // The next pose tells whether the newest is one.
    if (poses_.newest() == last && poses_.IsInJump(last)) return Fate::kWait;
    return poses_.oldest() <= first ? Fate::kPlace : Fate::kNoPose;
  }
  const Utime newest_scan = newest_scan_[scan.channel].value_or(scan.utime);
  return newest_scan >= last + options_.max_pose_wait ? Fate::kNoPose : Fate::kWait;
}

bool ScanQueue::OtherChannelsReached(const Scan& scan) const {
  if (poses_.newest() >= scan.utime + scan.last_beam + options_.max_order_wait) return true;
  return std::all_of(newest_scan_.begin(), newest_scan_.end(),
                     [&](const std::optional<Utime>& newest) { return newest >= scan.utime; });
}

void ScanQueue::Drain(bool end_of_input) {
  while (!waiting_.empty()) {
    const Scan& scan = waiting_.begin()->second;
    Fate fate = Judge(scan);
    if (fate == Fate::kPlace && !end_of_input && !OtherChannelsReached(scan)) fate = Fate::kWait;
    if (fate == Fate::kWait) {
      if (!end_of_input) return;
      fate = Fate::kNoPose;
    }
    if (fate == Fate::kPlace) {
      Place(scan);
    } else {
      CountWithoutPose(scan);
    }
    DropOldest();
  }
}

void ScanQueue::Place(const Scan& scan) {
  counts_.without_pose_in_a_row[scan.channel] = 0;
  PlacedScan placed;
  placed.channel = scan.channel;
  placed.utime = scan.utime;
  std::vector<Pose2> poses;  // of the sensor, by beam
  poses.reserve(scan.beams.size());
  std::optional<Utime> pose_time;
  Pose2 world_T_sensor;
  for (const Beam& beam : scan.beams) {
    if (const Utime utime = scan.utime + beam.time_offset; pose_time != utime) {
      const PoseBuffer::Bracket bracket = *poses_.Find(utime);  // Judge() saw that it is there
      if (bracket.after->utime - bracket.before->utime > options_.max_pose_gap) {
        ++counts_.drops[DropReason::kScanInPoseGap];
        return;
      }
      if (poses_.IsInJump(utime)) {
        ++counts_.drops[DropReason::kScanInPoseJump];
        return;
      }
      world_T_sensor = Interpolate(bracket, utime) * scan.robot_T_sensor;
      pose_time = utime;
    }
    poses.push_back(world_T_sensor);
  }
  // first_beam <= 0 <= last_beam: poses are on both sides of the scan's own time, too.
  const PoseBuffer::Bracket bracket = *poses_.Find(scan.utime);
  const Eigen::Vector3d up_robot = InterpolateUp(bracket, scan.utime);
  if (IsTiltedTooMuch(up_robot)) {
    ++counts_.drops[DropReason::kTiltedScan];
    return;
  }
  splinemap::Place(scan.beams, poses, placed.beams);
  Tilt(scan.beams, scan.robot_T_sensor.yaw_rad, up_robot, placed.beams);
  placed.world_T_robot = Interpolate(bracket, scan.utime);
  last_placed_ = {scan.utime, scan.channel};
  ready_.push_back(std::move(placed));
}

void ScanQueue::CountWithoutPose(const Scan& scan) {
  ++counts_.drops[DropReason::kScanWithoutPose];
  ++counts_.without_pose_in_a_row[scan.channel];
}

void ScanQueue::DropOldest() {
  beams_waiting_ -= waiting_.begin()->second.beams.size();
  waiting_.erase(waiting_.begin());
}

}  // namespace splinemap
