#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <queue>
#include <random>
#include <tuple>
#include <utility>
#include <vector>

#include "lib/base/clock.h"

namespace splinemap {

struct Weather {
  double loss = 0;
  double doubling = 0;
  std::chrono::milliseconds max_delay{0};  // random, so that messages overtake each other
};

// Calls what was sent when it arrives. Time is virtual.
class Network {
 public:
  static constexpr std::chrono::milliseconds kStep{20};

  Network(Weather weather, uint64_t seed) : weather_(weather), random_(seed) {}

  Clock::time_point now() const { return now_; }
  void SetWeather(Weather weather) { weather_ = weather; }
  void SetCut(bool is_cut) { is_cut_ = is_cut; }

  // To one receiver.
  void Send(std::function<void()> arrive) {
    if (is_cut_) return;
    std::uniform_real_distribution<double> chance(0, 1);
    const int copies = chance(random_) < weather_.doubling ? 2 : 1;
    for (int copy = 0; copy < copies; ++copy) {
      if (chance(random_) < weather_.loss) continue;
      const std::chrono::milliseconds delay(
          std::uniform_int_distribution<int64_t>(0, weather_.max_delay.count())(random_));
      on_the_way_.push({now_ + delay, ++sent_, arrive});
    }
  }

  void Advance() {
    now_ += kStep;
    while (!on_the_way_.empty() && on_the_way_.top().at <= now_) {
      const auto arrive = on_the_way_.top().arrive;
      on_the_way_.pop();
      arrive();
    }
  }

 private:
  struct OnTheWay {
    Clock::time_point at;
    uint64_t number;
    std::function<void()> arrive;
    bool operator<(const OnTheWay& other) const {
      return std::tie(at, number) > std::tie(other.at, other.number);
    }
  };

  Weather weather_;
  std::mt19937_64 random_;
  bool is_cut_ = false;
  Clock::time_point now_{std::chrono::hours(1)};
  uint64_t sent_ = 0;
  std::priority_queue<OnTheWay> on_the_way_;
};

template <typename... Values>
auto AnyOf(std::mt19937_64& random, Values... values) {
  const std::vector choices{values...};
  return choices[random() % choices.size()];
}

}  // namespace splinemap
