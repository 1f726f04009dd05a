#pragma once

#include <chrono>
#include <optional>

#include "lib/replication/protocol.h"

namespace splinemap {

// What an owner may send now. Half is for answers and half for pushes, so that neither can starve
// the other; what one does not need is the other's. Thread-compatible.
class ByteBudget {
 public:
  // What waits for the budget is tried again after that.
  static constexpr std::chrono::milliseconds kPause{10};

  explicit ByteBudget(double bytes_per_s) : bytes_per_s_(bytes_per_s) {}

  // Once for each tick.
  void Refill(Clock::time_point now, bool has_changes, bool has_pulls);

  bool MayAnswer() const { return answer_bytes_ > 0; }
  bool MayPush() const { return push_bytes_ > 0; }
  void SpendOnAnswers(size_t bytes) { answer_bytes_ -= static_cast<double>(bytes); }
  void SpendOnPushes(size_t bytes) { push_bytes_ -= static_cast<double>(bytes); }

 private:
  const double bytes_per_s_;
  double answer_bytes_ = 0;
  double push_bytes_ = 0;
  std::optional<Clock::time_point> last_refill_;
};

}  // namespace splinemap
