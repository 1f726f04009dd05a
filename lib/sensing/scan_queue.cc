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
  last_posed_.reset();
  std::fill(newest_scan_.begin(), newest_scan_.end(), std::nullopt);
}

size_t ScanQueue::size() const {
  return waiting_.size() + std::count_if(held_scans_.begin(), held_scans_.end(),
                                         [](const auto& held) { return held.has_value(); });
}

std::optional<PosedScan> ScanQueue::Next() {
  if (ready_.empty()) return std::nullopt;
  PosedScan scan = std::move(ready_.front());
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
  if (last_posed_ && key <= *last_posed_) {
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
    return poses_.oldest() <= first ? Fate::kPose : Fate::kNoPose;
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
    Scan& scan = waiting_.begin()->second;
    Fate fate = Judge(scan);
    if (fate == Fate::kPose && !end_of_input && !OtherChannelsReached(scan)) fate = Fate::kWait;
    if (fate == Fate::kWait) {
      if (!end_of_input) return;
      fate = Fate::kNoPose;
    }
    if (fate == Fate::kPose) {
      beams_waiting_ -= scan.beams.size();
      Pose(std::move(scan));
      waiting_.erase(waiting_.begin());
    } else {
      CountWithoutPose(scan);
      DropOldest();
    }
  }
}

void ScanQueue::Pose(Scan scan) {
  counts_.without_pose_in_a_row[scan.channel] = 0;
  // first_beam <= 0 <= last_beam: poses are on both sides of the scan's own time, too.
  const Pose2 world_T_robot = Interpolate(*poses_.Find(scan.utime), scan.utime);
  PosedScan posed{scan.channel, scan.utime, FixedPose2::Nearest(world_T_robot), {}, {}};
  const Pose2 robot_T_world = Inverse(posed.world_T_robot.ToPose());
  std::optional<Utime> pose_time;
  FixedPose2 robot_T_sensor;
  bool moved = false;
  const bool is_one_moment = scan.first_beam == scan.last_beam;
  const size_t poses = is_one_moment ? std::min<size_t>(scan.beams.size(), 1) : scan.beams.size();
  posed.robot_T_sensor.reserve(poses);
  for (const Beam& beam : absl::MakeConstSpan(scan.beams).first(poses)) {
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
      // Not by way of the world where nothing moved: rounding is seen there.
      robot_T_sensor = FixedPose2::Nearest(
          utime == scan.utime ? scan.robot_T_sensor
                              : robot_T_world * Interpolate(bracket, utime) * scan.robot_T_sensor);
      pose_time = utime;
    }
    moved = moved || (!posed.robot_T_sensor.empty() && robot_T_sensor != posed.robot_T_sensor[0]);
    posed.robot_T_sensor.push_back(robot_T_sensor);
  }
  if (!moved) posed.robot_T_sensor.resize(1, FixedPose2::Nearest(scan.robot_T_sensor));
  const Eigen::Vector3d up_robot = InterpolateUp(*poses_.Find(scan.utime), scan.utime);
  if (IsTiltedTooMuch(up_robot)) {
    ++counts_.drops[DropReason::kTiltedScan];
    return;
  }
  posed.beams = std::move(scan.beams);
  if (!is_one_moment) {
    for (Beam& beam : posed.beams) beam.time_offset = Utime(0);
  }
  Level(scan.robot_T_sensor.yaw_rad, up_robot, absl::MakeSpan(posed.beams));
  last_posed_ = {posed.utime, posed.channel};
  ready_.push_back(std::move(posed));
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
