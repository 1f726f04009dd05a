#include "lib/replication/scan_publisher.h"

#include <algorithm>
#include <chrono>
#include <string_view>
#include <utility>

#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/scan_record_t.hpp"

namespace splinemap {
namespace {

constexpr std::chrono::milliseconds kMaxScanWait(1000);
// LCM drops what comes while 30 messages wait for a subscriber, such as lcm-logger, and says
// nothing.
constexpr int kMaxMessagesAtOnce = 12;
constexpr std::chrono::milliseconds kPause(2);
constexpr uint64_t kMaxPulledScans = 256;  // of one range

}  // namespace

// Fills messages up to kMaxMessageBytes; what is longer goes in parts.
class ScanPublisher::Batch {
 public:
  Batch(const ScanPublisher& publisher, std::vector<ReplicationMessage>& messages)
      : messages_(messages) {
    message_.speaker = publisher.speaker_;
    message_.layer = splinemap::ToMessage(publisher.ref_);
    message_.oldest = static_cast<int64_t>(publisher.Oldest());
    message_.num_scans = 0;
    empty_bytes_ = static_cast<size_t>(message_.getEncodedSize());
    bytes_ = empty_bytes_;
  }
  ~Batch() {
    if (!message_.scans.empty()) Send();
  }

  // Returns what it adds to the bytes sent.
  size_t Add(const SentScan& scan) {
    scan_record_t record;
    record.revision = static_cast<int64_t>(scan.revision);
    record.utime = scan.utime.count();
    record.robot_x = scan.layer_T_robot.x;
    record.robot_y = scan.layer_T_robot.y;
    record.robot_yaw = scan.layer_T_robot.yaw;
    record.num_bytes = 0;
    const auto header_bytes = static_cast<size_t>(record._getEncodedSizeNoHash());
    const size_t room = kMaxMessageBytes - empty_bytes_ - header_bytes;
    const size_t num_parts = std::max<size_t>((scan.beams.size() + room - 1) / room, 1);
    record.num_parts = static_cast<int16_t>(num_parts);
    for (size_t part = 0; part < num_parts; ++part) {
      const std::string_view content = std::string_view(scan.beams).substr(part * room, room);
      record.part = static_cast<int16_t>(part);
      record.content.assign(content.begin(), content.end());
      record.num_bytes = static_cast<int32_t>(content.size());
      if (bytes_ + header_bytes + content.size() > kMaxMessageBytes) Send();
      bytes_ += header_bytes + content.size();
      message_.scans.push_back(record);
    }
    return num_parts * header_bytes + scan.beams.size();
  }

  int num_messages() const { return num_sent_ + (message_.scans.empty() ? 0 : 1); }

  // Without scans it tells which there are.
  void Send() {
    ++num_sent_;
    message_.num_scans = static_cast<int32_t>(message_.scans.size());
    messages_.emplace_back(message_);
    message_.scans.clear();
    bytes_ = empty_bytes_;
  }

 private:
  std::vector<ReplicationMessage>& messages_;
  layer_scans_t message_;
  size_t empty_bytes_;
  size_t bytes_;
  int num_sent_ = 0;
};

ScanPublisher::ScanPublisher(LayerRef ref, int64_t speaker, uint64_t revision, RecentScans& scans,
                             bool pushes)
    : ref_(std::move(ref)),
      speaker_(speaker),
      scans_(scans),
      pushes_(pushes),
      revision_(revision),
      pushed_(revision) {}

void ScanPublisher::SetRevision(uint64_t revision, Clock::time_point now) {
  if (pushes_ && revision > revision_) waiting_.push_back({revision, now});
  revision_ = revision;
  if (!pushes_) pushed_ = revision;
}

uint64_t ScanPublisher::Oldest() const {
  return scans_.IsEmpty() ? revision_ + 1 : scans_.oldest();
}

void ScanPublisher::HandlePull(const scan_pull_t& pull) {
  for (int k = 0; k < pull.num_ranges; ++k) {
    const auto first = static_cast<uint64_t>(pull.first[k]);
    const auto last = std::min(static_cast<uint64_t>(pull.last[k]), pushed_);
    if (first > last) continue;
    lacks_pulled_ |= first < Oldest();
    const uint64_t begin = std::max(first, Oldest());
    for (uint64_t revision = begin; revision <= last && revision < begin + kMaxPulledScans;
         ++revision) {
      pulled_.Push(revision);
    }
  }
}

void ScanPublisher::Tick(Clock::time_point now, ByteBudget& budget,
                         std::vector<ReplicationMessage>& messages) {
  if (now < next_tick_ && (HasChanges() || HasPulls())) return;
  Batch batch(*this, messages);
  Answer(batch, budget);
  Push(batch, budget);
  GiveUpWhatIsOld(now);
  const bool is_spent = (HasChanges() && !budget.MayPush()) || (HasPulls() && !budget.MayAnswer());
  next_tick_ = HasChanges() || HasPulls() ? now + (is_spent ? ByteBudget::kPause : kPause)
                                          : Clock::time_point();
}

void ScanPublisher::Answer(Batch& batch, ByteBudget& budget) {
  if (std::exchange(lacks_pulled_, false)) batch.Send();
  while (!pulled_.empty() && budget.MayAnswer() && batch.num_messages() < kMaxMessagesAtOnce) {
    const SentScan* scan = scans_.Find(pulled_.Pop());
    if (scan != nullptr) budget.SpendOnAnswers(batch.Add(*scan));
  }
}

void ScanPublisher::Push(Batch& batch, ByteBudget& budget) {
  while (HasChanges() && budget.MayPush() && batch.num_messages() < kMaxMessagesAtOnce) {
    const SentScan* scan = scans_.Find(++pushed_);
    if (scan != nullptr) budget.SpendOnPushes(batch.Add(*scan));
  }
}

void ScanPublisher::GiveUpWhatIsOld(Clock::time_point now) {
  while (!waiting_.empty() &&
         (waiting_.front().revision <= pushed_ || now - waiting_.front().since > kMaxScanWait)) {
    if (waiting_.front().revision > pushed_) {
      pushed_ = waiting_.front().revision;
      scans_.DropUpTo(pushed_);
    }
    waiting_.pop_front();
  }
}

Clock::time_point ScanPublisher::NextTick() const {
  if (!HasChanges() && !HasPulls()) return Clock::time_point::max();
  return next_tick_;
}

}  // namespace splinemap
