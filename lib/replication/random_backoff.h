#pragma once

#include <cstdint>
#include <random>

#include "lib/replication/protocol.h"

namespace splinemap {

// Spreads the times at which those who follow speak. Thread-compatible.
class RandomBackoff {
 public:
  explicit RandomBackoff(uint64_t seed) : random_(seed) {}

  Clock::duration UpTo(Clock::duration at_most) {
    return Clock::duration(std::uniform_int_distribution<Clock::rep>(0, at_most.count())(random_));
  }

 private:
  std::mt19937_64 random_;
};

}  // namespace splinemap
