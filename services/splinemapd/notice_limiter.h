#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "lib/base/clock.h"
#include "lib/pipeline/notice.h"

namespace splinemap {

// Says notices of one subject once, and then once a minute while they go on. Thread-compatible.
class NoticeLimiter {
 public:
  // What to say of a notice now, or nothing.
  std::optional<std::string> Say(const Notice& notice, Clock::time_point now);
  // That is over: the next notice of the subject is said at once.
  void Forget(const std::string& subject) { subjects_.erase(subject); }

 private:
  struct Subject {
    Clock::time_point said;
    int64_t unsaid = 0;
  };
  std::map<std::string, Subject> subjects_;
};

}  // namespace splinemap
