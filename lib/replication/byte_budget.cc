#include "lib/replication/byte_budget.h"

#include <algorithm>

namespace splinemap {
namespace {

constexpr double kMaxBurst_s = 0.25;

}  // namespace

void ByteBudget::Refill(Clock::time_point now, bool has_changes, bool has_pulls) {
  const double passed_s =
      last_refill_ ? std::chrono::duration<double>(now - *last_refill_).count() : kMaxBurst_s;
  last_refill_ = now;
  const double half = passed_s * bytes_per_s_ / 2;
  const double most = kMaxBurst_s * bytes_per_s_;
  answer_bytes_ += half;
  push_bytes_ += half;
  if (!has_changes) {
    answer_bytes_ += std::max(push_bytes_, 0.0);
    push_bytes_ = std::min(push_bytes_, 0.0);
  } else if (!has_pulls) {
    push_bytes_ += std::max(answer_bytes_, 0.0);
    answer_bytes_ = std::min(answer_bytes_, 0.0);
  }
  answer_bytes_ = std::min(answer_bytes_, most);
  push_bytes_ = std::min(push_bytes_, most);
}

}  // namespace splinemap
