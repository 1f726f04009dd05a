#pragma once

#include <compare>
#include <cstdint>
#include <utility>

namespace splinemap {

// What a control point of a coarser level says of the finer ones that it stands for.
enum class Statistic : int8_t {
  kMean = 0,  // a control point of the smoothed surface
  kMin = 1,   // the least and the greatest of them: what is free or occupied does not vanish
  kMax = 2,
};
inline constexpr int kNumStatistics = 3;

// How a layer is seen. At level n the knot interval is 2^n times that of the map; level 0, as it
// was mapped, has values only.
struct LevelOfDetail {
  static constexpr int kMaxLevel = 8;

  int level = 0;
  Statistic statistic = Statistic::kMean;

  auto operator<=>(const LevelOfDetail&) const = default;
  template <typename H>
  friend H AbslHashValue(H h, const LevelOfDetail& level_of_detail) {
    return H::combine(std::move(h), level_of_detail.level,
                      static_cast<int>(level_of_detail.statistic));
  }

  bool IsValid() const {
    const auto number = static_cast<int>(statistic);
    return level >= 0 && level <= kMaxLevel && number >= 0 && number < kNumStatistics &&
           (level > 0 || statistic == Statistic::kMean);
  }
};

}  // namespace splinemap
