#pragma once

#include <compare>
#include <cstdint>
#include <utility>

namespace splinemap {

// What a control point of a coarser level says of the finer ones that it stands for.
enum class Band : int8_t {
  kValue = 0,  // a control point of the smoothed surface
  kMin = 1,    // the least and the greatest of them: what is free or occupied does not vanish
  kMax = 2,
};
inline constexpr int kNumBands = 3;

// How a layer is seen. At level n the knot interval is 2^n times that of the map; level 0, as it
// was mapped, has values only.
struct Detail {
  static constexpr int kMaxLevel = 8;

  int level = 0;
  Band band = Band::kValue;

  auto operator<=>(const Detail&) const = default;
  template <typename H>
  friend H AbslHashValue(H h, const Detail& detail) {
    return H::combine(std::move(h), detail.level, static_cast<int>(detail.band));
  }

  bool IsValid() const {
    const auto number = static_cast<int>(band);
    return level >= 0 && level <= kMaxLevel && number >= 0 && number < kNumBands &&
           (level > 0 || band == Band::kValue);
  }
};

}  // namespace splinemap
