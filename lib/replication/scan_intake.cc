#include "lib/replication/scan_intake.h"

#include <algorithm>
#include <utility>

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// What is beyond is asked for when its turn comes.
constexpr size_t kMaxScans = 1024;
constexpr size_t kMaxBytes = size_t{4} << 20;
constexpr size_t kMaxRanges = 64;  // so that a pull is one frame
constexpr uint64_t kMaxAsked = 256;
// What others have overtaken mostly comes within this time; and of several followers that lack the
// same scan, one asks first.
constexpr milliseconds kScanPatience(20);
constexpr milliseconds kMaxScanBackOff(30);
constexpr milliseconds kScanRetry(150);
// Who hears others ask for the same this often without an answer, asks as well.
constexpr int kMaxScanPulls = 10;

size_t BytesOf(const std::string& part) {
  constexpr size_t kOverhead = 100;  // of the containers, about
  return kOverhead + part.size();
}

}  // namespace

bool ScanIntake::Has(uint64_t revision) const {
  const auto scan = scans_.find(revision);
  return scan != scans_.end() && scan->second.IsWhole();
}

bool ScanIntake::Add(const scan_record_t& record) {
  const SentScan header{static_cast<uint64_t>(record.revision),
                        Utime(record.utime),
                        {record.robot_x, record.robot_y, record.robot_yaw},
                        {}};
  auto scan = scans_.find(header.revision);
  // Of two that differ one is not the owner's, and which, nobody knows: the later counts.
  if (scan != scans_.end() &&
      (scan->second.num_parts != record.num_parts || scan->second.scan.utime != header.utime ||
       scan->second.scan.layer_T_robot != header.layer_T_robot)) {
    Erase(scan);
    scan = scans_.end();
  }
  if (scan == scans_.end()) {
    scan = scans_.emplace(header.revision, Received{header, record.num_parts, {}}).first;
  }
  const auto [part, is_new] =
      scan->second.parts.try_emplace(record.part, record.content.begin(), record.content.end());
  if (!is_new) return false;
  bytes_ += BytesOf(part->second);
  while (scans_.size() > kMaxScans || bytes_ > kMaxBytes) Erase(std::prev(scans_.end()));
  return true;
}

std::optional<SentScan> ScanIntake::Take(uint64_t revision) {
  const auto scan = scans_.find(revision);
  if (scan == scans_.end() || !scan->second.IsWhole()) return std::nullopt;
  SentScan taken = std::move(scan->second.scan);
  for (const auto& [number, part] : scan->second.parts) taken.beams += part;
  Erase(scan);
  return taken;
}

ScanIntake::Scans::iterator ScanIntake::Erase(Scans::iterator scan) {
  for (const auto& [number, part] : scan->second.parts) bytes_ -= BytesOf(part);
  return scans_.erase(scan);
}

void ScanIntake::ForgetUpTo(uint64_t revision) {
  while (!scans_.empty() && scans_.begin()->first <= revision) Erase(scans_.begin());
}

void ScanIntake::ForgetAfter(uint64_t revision) {
  while (newest() > revision) Erase(std::prev(scans_.end()));
}

void ScanIntake::Clear() {
  scans_.clear();
  bytes_ = 0;
  gap_.reset();
}

void ScanIntake::SetGap(uint64_t folded, uint64_t newest, Clock::time_point now) {
  if (folded >= newest) {
    gap_.reset();
  } else if (gap_ && gap_->folded == folded) {
    gap_->newest = newest;
  } else {
    gap_ = Gap{folded, newest, now + kScanPatience + random_.UpTo(kMaxScanBackOff)};
  }
}

std::optional<scan_pull_t> ScanIntake::Ask(Clock::time_point now) {
  if (!gap_ || gap_->due > now) return std::nullopt;
  scan_pull_t pull{};
  const uint64_t last = std::min(gap_->newest, gap_->folded + kMaxAsked);
  bool is_in_range = false;
  for (uint64_t revision = gap_->folded + 1; revision <= last; ++revision) {
    const bool is_lacking = !Has(revision);
    if (is_lacking && !is_in_range) {
      if (pull.first.size() == kMaxRanges) break;
      pull.first.push_back(static_cast<int64_t>(revision));
      pull.last.push_back(0);
    }
    if (is_lacking) pull.last.back() = static_cast<int64_t>(revision);
    is_in_range = is_lacking;
  }
  pull.num_ranges = static_cast<int32_t>(pull.first.size());
  ++gap_->times_asked;
  gap_->due = now + kScanRetry + random_.UpTo(kScanRetry);
  return pull;
}

void ScanIntake::HandlePull(const scan_pull_t& pull, Clock::time_point now) {
  if (!gap_) return;
  const auto lacking = static_cast<int64_t>(gap_->folded + 1);
  for (int k = 0; k < pull.num_ranges; ++k) {
    if (lacking < pull.first[k] || lacking > pull.last[k]) continue;
    if (++gap_->times_postponed > kMaxScanPulls) return;
    gap_->due = std::max(gap_->due, now + kScanRetry + random_.UpTo(kMaxScanBackOff));
    return;
  }
}

}  // namespace splinemap
