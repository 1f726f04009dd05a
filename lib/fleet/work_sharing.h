#pragma once

#include <cstdint>
#include <map>
#include <set>

#include "lib/base/clock.h"
#include "lib/fleet/fleet_key.h"
#include "lib/fleet/query_tiles.h"

// Which worker has which parts of the map, decided by each for itself from who is there.

namespace splinemap {

// So many have each part, so that one may end.
inline constexpr int kOwners = 2;

// Of one worker among `workers`, the ids of all that are there, itself too. Where one comes or
// goes, no parts move but those that it gets or had (rendezvous hashing).
struct WorkShare {
  PartSet parts;      // it is one of the owners
  PartSet published;  // it is the first of them, who publishes the sum
};
WorkShare ShareOf(uint64_t worker, const std::set<uint64_t>& workers);

// Who is there: those heard of lately. Thread-compatible.
class WorkersHeard {
 public:
  // The interval at which workers tell their ids, and for how long they are believed.
  static constexpr std::chrono::milliseconds kTellInterval{1000};
  static constexpr std::chrono::milliseconds kPatience{3500};

  // More than that are not heard.
  static constexpr size_t kMaxWorkers = 4096;

  void Hear(uint64_t worker, Clock::time_point now);
  std::set<uint64_t> Alive(Clock::time_point now);

 private:
  std::map<uint64_t, Clock::time_point> heard_;
};

}  // namespace splinemap
