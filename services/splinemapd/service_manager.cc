#include "services/splinemapd/service_manager.h"

#include <spdlog/spdlog.h>
#include <systemd/sd-daemon.h>

#include <chrono>
#include <string>

#include "lib/base/plain_text.h"

namespace splinemap {
namespace {

// One line.
std::string TextOf(const Daemon::Published& published) {
  const status_t& status = published.status;
  return fmt::format(
      "{} of {} scans mapped, {} tiles, {} layers{}", status.scans_mapped, status.scans_received,
      status.tiles, published.layers.num_layers,
      status.last_problem.empty() ? "" : "; last problem: " + PlainText(status.last_problem));
}

void Say(const std::string& state) { sd_notify(/*unset_environment=*/0, state.c_str()); }

}  // namespace

ServiceManager::ServiceManager() {
  uint64_t watchdog_us = 0;
  if (sd_watchdog_enabled(/*unset_environment=*/0, &watchdog_us) > 0) {
    interval_ = std::chrono::microseconds(watchdog_us / 2);
  }
}

void ServiceManager::SayAlive(Daemon& daemon) {
  if (Clock::now() < next_) return;
  next_ = interval_ ? Clock::now() + *interval_ : Clock::time_point::max();
  if (const auto hanging = daemon.FindHangingThread()) {
    spdlog::error("the thread that {} hangs; systemd restarts splinemapd if that lasts", *hanging);
    return;
  }
  Say("READY=1\nWATCHDOG=1\nSTATUS=" + TextOf(*daemon.published()));
}

void ServiceManager::SayStopping() { Say("STOPPING=1\nSTATUS=saves the map"); }

}  // namespace splinemap
