#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/scan_record_t.hpp"
#include "lib/replication/protocol.h"
#include "lib/replication/random_backoff.h"
#include "lib/replication/recent_scans.h"

namespace splinemap {

// Scans of one session of a layer that a follower has received, in any order, and not folded yet;
// and when to ask for those that it lacks. Bounded in memory. Thread-compatible.
class ScanIntake {
 public:
  // `seed` spreads the times at which followers ask.
  explicit ScanIntake(uint64_t seed) : random_(seed) {}

  // False where it was received already.
  bool Add(const scan_record_t& record);
  // The scan of this revision, which is not kept; nothing where not all of it was received.
  std::optional<SentScan> Take(uint64_t revision);
  bool Has(uint64_t revision) const;
  // Of any scan of which something was received; 0 where there is none.
  uint64_t newest() const { return scans_.empty() ? 0 : scans_.rbegin()->first; }

  // Nothing that came of these is wanted.
  void ForgetUpTo(uint64_t revision);
  void ForgetAfter(uint64_t revision);
  void Clear();

  // The follower has folded all up to `folded` and lacks the next; there are those up to `newest`.
  // Where these are the same, it lacks nothing.
  void SetGap(uint64_t folded, uint64_t newest, Clock::time_point now);
  void ForgetGap() { gap_.reset(); }
  // How often the oldest scan that is lacking was asked for, as long as it does not come.
  int times_asked() const { return gap_ ? gap_->times_asked : 0; }
  // What is to be asked for now, without speaker and layer.
  std::optional<scan_pull_t> Ask(Clock::time_point now);
  // When that will be, if nothing comes before.
  std::optional<Clock::time_point> next_ask() const {
    return gap_ ? std::optional(gap_->due) : std::nullopt;
  }
  // Another follower asks: the answer will come here, too.
  void HandlePull(const scan_pull_t& pull, Clock::time_point now);

 private:
  struct Received {
    SentScan scan;  // without beams
    int num_parts = 0;
    std::map<int, std::string> parts;

    bool IsWhole() const { return static_cast<int>(parts.size()) == num_parts; }
  };
  struct Gap {
    uint64_t folded = 0;
    uint64_t newest = 0;
    Clock::time_point due;
    int times_asked = 0;
    int times_postponed = 0;
  };
  using Scans = std::map<uint64_t, Received>;  // by revision

  Scans::iterator Erase(Scans::iterator scan);

  RandomBackoff random_;
  Scans scans_;
  size_t bytes_ = 0;
  std::optional<Gap> gap_;
};

}  // namespace splinemap
