#pragma once

#include <map>
#include <string>

#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/replica/map_replica.h"

namespace splinemap {

// What `splinemap watch` shows in a terminal: daemons, layers and a preview of the map, drawn anew
// in place. Thread-compatible.
class LiveView {
 public:
  explicit LiveView(const MapReplica& replica) : replica_(replica) {}

  void HandleStatus(const status_t& status);

  // The screen, with control sequences. Rates are those since the last call.
  std::string Draw(Clock::time_point now);

 private:
  struct Daemon {
    status_t status;
    double scans_per_s = 0;
    Clock::time_point heard;
  };

  std::string DaemonLines(Clock::time_point now) const;
  std::string LayerLines(double passed_s);

  const MapReplica& replica_;
  std::map<int64_t, Daemon> daemons_;  // by nonce
  int64_t bytes_ = 0;
  Clock::time_point last_drawn_ = Clock::now();
};

// One line on a daemon. Texts come from the bus: control characters are shown, not sent to the
// terminal.
std::string StatusLine(const status_t& status);

}  // namespace splinemap
