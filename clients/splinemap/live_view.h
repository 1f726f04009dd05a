#pragma once

#include <map>
#include <string>

#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/clock.h"
#include "splinemap/replica.h"

namespace splinemap {

// The screen of `splinemap watch`: daemons, layers and a preview of the map. Thread-compatible.
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
    Clock::time_point received;
  };

  std::string DaemonLines(Clock::time_point now) const;
  std::string LayerLines(double passed_s);

  const MapReplica& replica_;
  std::map<int64_t, Daemon> daemons_;  // by nonce
  int64_t bytes_ = 0;
  const Clock::time_point started_ = Clock::now();
  Clock::time_point last_drawn_ = started_;
};

// `text` and below it a preview of the map, where there is room for one; with control sequences,
// from the upper left corner of the screen. `wrapped` lines of the text take two rows.
std::string ScreenOf(std::string text, int wrapped, const MapView& map);

// One line about a daemon. It is PlainText, since names and problems come from the bus.
std::string StatusLine(const status_t& status);

}  // namespace splinemap
