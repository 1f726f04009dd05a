#pragma once

#include <optional>

#include "lib/base/clock.h"
#include "services/splinemapd/daemon.h"

namespace splinemap {

// Tells systemd how the daemon is (sd_notify(3)); does nothing where something else started it.
// Thread-compatible.
class ServiceManager {
 public:
  ServiceManager();

  // For a daemon that has published its status, about once a second: says that it is ready, what it
  // has done and that it is alive, once and then twice in the time after which a watchdog restarts
  // it. Says nothing, but to the log, where a thread hangs.
  void SayAlive(Daemon& daemon);
  void SayStopping();

 private:
  std::optional<Clock::duration> interval_;  // nothing without a watchdog
  Clock::time_point next_;
};

}  // namespace splinemap
