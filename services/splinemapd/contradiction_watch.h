#pragma once

#include <map>
#include <memory>

#include "lib/base/clock.h"
#include "lib/map/contradictions.h"
#include "services/splinemapd/newest_map.h"

namespace splinemap {

// Compares the layers of a daemon with each other from time to time: every 10 s where they change,
// at once where their settings do, and for a hundredth of the time at most. Thread-compatible.
class ContradictionWatch {
 public:
  explicit ContradictionWatch(Clock::time_point now) : due_(now + kInterval) {}

  // The newest comparison; false where it is the one of the last call.
  bool Check(NewestMap& newest);
  const std::map<LayerId, Contradiction>& contradictions() const { return contradictions_; }

 private:
  static constexpr std::chrono::seconds kInterval{10};

  Clock::time_point due_;       // where tiles changed
  Clock::time_point earliest_;  // where settings did
  std::shared_ptr<const LayerSet> compared_;
  std::map<LayerId, Contradiction> contradictions_;
};

}  // namespace splinemap
