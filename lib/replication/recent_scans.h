#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>

#include "splinemap/fixed_pose2.h"
#include "splinemap/utime.h"

namespace splinemap {

// A scan of a layer as it is sent.
struct SentScan {
  uint64_t revision = 0;  // of the layer, with the commit that mapped it
  Utime utime{0};
  FixedPose2 layer_T_robot;
  std::string beams;  // PackBeams()
};

// The newest scans of a layer that can still be sent, in the order of their revisions and without a
// gap: beyond kMaxBytes the tiles that they changed are shorter. Thread-compatible.
class RecentScans {
 public:
  static constexpr size_t kMaxBytes = size_t{1} << 19;

  bool IsEmpty() const { return scans_.empty(); }
  // Of their revisions. Requires !IsEmpty().
  uint64_t oldest() const { return scans_.front().revision; }
  uint64_t newest() const { return scans_.back().revision; }
  // Null where it is not here.
  const SentScan* Find(uint64_t revision) const {
    if (IsEmpty() || revision < oldest() || revision > newest()) return nullptr;
    return &scans_[revision - oldest()];
  }

  // After all others; where there is a gap before it, those are dropped.
  void Add(SentScan scan) {
    if (!IsEmpty() && scan.revision != newest() + 1) Clear();
    bytes_ += BytesOf(scan);
    scans_.push_back(std::move(scan));
    while (bytes_ > kMaxBytes && scans_.size() > 1) {
      bytes_ -= BytesOf(scans_.front());
      scans_.pop_front();
    }
  }
  void DropAfter(uint64_t revision) {
    while (!IsEmpty() && newest() > revision) {
      bytes_ -= BytesOf(scans_.back());
      scans_.pop_back();
    }
  }
  void DropUpTo(uint64_t revision) {
    while (!IsEmpty() && oldest() <= revision) {
      bytes_ -= BytesOf(scans_.front());
      scans_.pop_front();
    }
  }
  void Clear() {
    scans_.clear();
    bytes_ = 0;
  }

 private:
  static size_t BytesOf(const SentScan& scan) { return sizeof(SentScan) + scan.beams.size(); }

  std::deque<SentScan> scans_;
  size_t bytes_ = 0;
};

}  // namespace splinemap
