#pragma once

#include <chrono>
#include <cstdint>

#include "lib/base/clock.h"

namespace splinemap {

// Notices when nothing comes on a channel, and when it comes again. Thread-compatible.
class SilenceWatch {
 public:
  static constexpr std::chrono::seconds kSilence{5};

  explicit SilenceWatch(Clock::time_point now) : since_(now) {}

  enum class Change { kNone, kSilent, kHeardAgain };
  // `messages`: on the channel, in total.
  Change Check(int64_t messages, Clock::time_point now) {
    if (messages != messages_) {
      messages_ = messages;
      since_ = now;
      if (!is_silent_) return Change::kNone;
      is_silent_ = false;
      return Change::kHeardAgain;
    }
    if (is_silent_ || now - since_ < kSilence) return Change::kNone;
    is_silent_ = true;
    return Change::kSilent;
  }

 private:
  int64_t messages_ = 0;
  Clock::time_point since_;
  bool is_silent_ = false;
};

}  // namespace splinemap
