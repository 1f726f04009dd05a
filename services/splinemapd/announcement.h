#pragma once

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "lib/base/clock.h"

namespace splinemap {

// When a message about a state is to be published that is looked at again and again: where the
// state is another one, where somebody asks, and no later than `longest` after the last one.
// Thread-compatible.
class Announcement {
 public:
  explicit Announcement(Clock::duration longest) : longest_(longest) {}

  // `state`: what is equal where nothing changed.
  bool IsDue(std::vector<uint8_t> state, bool was_asked, Clock::time_point now) {
    if (!was_asked && last_ && state_ == state && now - *last_ < longest_) return false;
    state_ = std::move(state);
    last_ = now;
    return true;
  }

 private:
  const Clock::duration longest_;
  std::vector<uint8_t> state_;
  std::optional<Clock::time_point> last_;
};

}  // namespace splinemap
