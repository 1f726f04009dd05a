#pragma once

#include <cmath>
#include <concepts>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace splinemap {

// What a field may hold and hardly any program expects: the ends of its type, powers of two and
// what is beside them, and neighbours of the value that it has.
template <std::integral Number>
std::vector<Number> Extremes(Number now) {
  using Limits = std::numeric_limits<Number>;
  std::vector<Number> values{0,
                             1,
                             Limits::max(),
                             static_cast<Number>(Limits::max() - 1),
                             Limits::min(),
                             static_cast<Number>(Limits::min() + 1)};
  // Sums modulo 2^bits are what a hostile sender can make as well.
  const auto add = [&](uint64_t value) { values.push_back(static_cast<Number>(value)); };
  for (const uint64_t step : {uint64_t{1}, ~uint64_t{0}}) add(static_cast<uint64_t>(now) + step);
  for (const int bits : {2, 8, 16, 23, 26, 30, 31, 32, 53, 61, 62}) {
    if (bits >= Limits::digits) break;
    for (const uint64_t beside : {~uint64_t{0}, uint64_t{0}, uint64_t{1}}) {
      const uint64_t value = (uint64_t{1} << bits) + beside;
      add(value);
      add(-value);
    }
  }
  return values;
}

template <std::floating_point Number>
std::vector<Number> Extremes(Number now) {
  using Limits = std::numeric_limits<Number>;
  std::vector<Number> values;
  for (const Number value :
       {Number{0}, Number{1}, Limits::infinity(), Limits::quiet_NaN(), Limits::signaling_NaN(),
        Limits::denorm_min(), Limits::min(), Limits::max(), Limits::epsilon(),
        static_cast<Number>(0.001), static_cast<Number>(0.1), Number{10'000},
        std::ldexp(Number{1}, 31), std::ldexp(Number{1}, 53), std::ldexp(Number{1}, 63), now * 2,
        std::nextafter(now, Limits::max()), std::nextafter(now, Limits::lowest())}) {
    values.push_back(value);
    values.push_back(-value);
  }
  return values;
}

inline std::vector<std::string> Extremes(const std::string& now) {
  return {"",
          "x",
          std::string(255, 'x'),
          std::string(256, 'x'),
          std::string(257, 'x'),
          std::string(30'000, 'x'),
          std::string("a\0b", 3),
          std::string(1, '\0'),
          now + '\0',
          "a\nb\r",
          "\x1b[2J\x1b]0;x\x07",
          "\xff\xfe\xc0\x80",
          "\xe2\x80\xae"
          "abc",
          "../../x",
          "*",
          "%s%n",
          now + "x"};
}

}  // namespace splinemap
