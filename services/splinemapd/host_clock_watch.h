#pragma once

#include <chrono>
#include <optional>

namespace splinemap {

// Notices when somebody sets the clock of this computer. Thread-compatible.
class HostClockWatch {
 public:
  using Duration = std::chrono::duration<double>;

  // How far the system clock was set, forward or back, since the last call; nothing where it was
  // less than half a second. `since_boot` counts sleep, too.
  std::optional<Duration> Check(std::chrono::system_clock::time_point system,
                                std::chrono::nanoseconds since_boot) {
    const Duration offset = Duration(system.time_since_epoch()) - Duration(since_boot);
    const Duration jump = last_offset_ ? offset - *last_offset_ : Duration(0);
    last_offset_ = offset;
    constexpr Duration kSlewing(0.5);
    return jump > kSlewing || jump < -kSlewing ? std::optional(jump) : std::nullopt;
  }

 private:
  std::optional<Duration> last_offset_;
};

}  // namespace splinemap
