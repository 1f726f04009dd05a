#include "lib/tiles/sum_tiles.h"

#include <cstring>
#ifdef __aarch64__
#include <arm_neon.h>
#endif

namespace splinemap {
namespace {

// Control points and their sums by the width of a vector. (Of templates GCC 12 makes no vectors.)
struct Eight {
  static constexpr int kCount = 8;
  typedef int16_t Points __attribute__((vector_size(16)));
  typedef int32_t Sums __attribute__((vector_size(32)));
};
struct Sixteen {
  static constexpr int kCount = 16;
  typedef int16_t Points __attribute__((vector_size(32)));
  typedef int32_t Sums __attribute__((vector_size(64)));
};

// A row, which is one cache line of each tile, at a time. Inlined, so that each caller has it in
// its own instructions.
template <typename Vector>
__attribute__((always_inline)) inline void Merge(const std::vector<const Tile*>& tiles,
                                                 ControlLimits limits, Tile& merged) {
  using Points = typename Vector::Points;
  using Sums = typename Vector::Sums;
  constexpr int kVectors = Tile::kSide / Vector::kCount;
  constexpr int kRowsAhead = 4;  // no processor foresees the rows of many tiles
  const Sums min = Sums{} + limits.min;
  const Sums max = Sums{} + limits.max;
  for (int row = 0; row < Tile::kSize; row += Tile::kSide) {
    Sums sums[kVectors] = {};
    Points touched[kVectors] = {};
    Points points[kVectors];
    for (const Tile* tile : tiles) {
      if (tile == nullptr) continue;
      const ControlPoint* first = tile->control_points.data() + row;
      __builtin_prefetch(first + kRowsAhead * Tile::kSide);
      std::memcpy(points, first, sizeof(points));
#pragma GCC unroll 4
      for (int k = 0; k < kVectors; ++k) {
        sums[k] += __builtin_convertvector(points[k], Sums);
        touched[k] |= points[k];
      }
    }
#pragma GCC unroll 4
    for (int k = 0; k < kVectors; ++k) {
      Sums sum = sums[k] < min ? min : sums[k];
      sum = sum > max ? max : sum;
      sum -= sum == 0;  // a comparison that holds is -1: what was touched is never 0
      points[k] = __builtin_convertvector(sum, Points) & (touched[k] != 0);
    }
    std::memcpy(merged.control_points.data() + row, points, sizeof(points));
  }
}

void MergePlain(const std::vector<const Tile*>& tiles, ControlLimits limits, Tile& merged) {
  Merge<Eight>(tiles, limits, merged);
}

#ifdef __x86_64__
__attribute__((target("avx2"))) void MergeAvx2(const std::vector<const Tile*>& tiles,
                                               ControlLimits limits, Tile& merged) {
  Merge<Eight>(tiles, limits, merged);
}

__attribute__((target("avx512bw,avx512vl"))) void MergeAvx512(const std::vector<const Tile*>& tiles,
                                                              ControlLimits limits, Tile& merged) {
  Merge<Sixteen>(tiles, limits, merged);
}
#endif

#ifdef __aarch64__
// Limits have 16 bits, and so sums may saturate before they are kept within them.
void MergeNeon(const std::vector<const Tile*>& tiles, ControlLimits limits, Tile& merged) {
  constexpr int kVectors = Tile::kSide / 8;
  const int16x8_t min = vdupq_n_s16(limits.min);
  const int16x8_t max = vdupq_n_s16(limits.max);
  for (int row = 0; row < Tile::kSize; row += Tile::kSide) {
    int32x4_t low[kVectors] = {};
    int32x4_t high[kVectors] = {};
    int16x8_t touched[kVectors] = {};
    for (const Tile* tile : tiles) {
      if (tile == nullptr) continue;
      const ControlPoint* first = tile->control_points.data() + row;
      for (int k = 0; k < kVectors; ++k) {
        const int16x8_t points = vld1q_s16(first + 8 * k);
        low[k] = vaddw_s16(low[k], vget_low_s16(points));
        high[k] = vaddw_high_s16(high[k], points);
        touched[k] = vorrq_s16(touched[k], points);
      }
    }
    for (int k = 0; k < kVectors; ++k) {
      int16x8_t sum = vqmovn_high_s32(vqmovn_s32(low[k]), high[k]);
      sum = vminq_s16(vmaxq_s16(sum, min), max);
      sum = vsubq_s16(sum, vreinterpretq_s16_u16(vceqzq_s16(sum)));  // touched: never 0
      const uint16x8_t is_touched = vtstq_s16(touched[k], touched[k]);
      vst1q_s16(merged.control_points.data() + row + 8 * k,
                vandq_s16(sum, vreinterpretq_s16_u16(is_touched)));
    }
  }
}
#endif

}  // namespace

std::vector<TileMerger> TileMergers() {
  std::vector<TileMerger> mergers;
#ifdef __x86_64__
  if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl")) {
    mergers.push_back({"avx512", MergeAvx512});
  }
  if (__builtin_cpu_supports("avx2")) mergers.push_back({"avx2", MergeAvx2});
#endif
#ifdef __aarch64__
  mergers.push_back({"neon", MergeNeon});
#endif
  mergers.push_back({"plain", MergePlain});
  return mergers;
}

Tile SumTiles(const std::vector<const Tile*>& tiles, ControlLimits limits) {
  static const auto merge = TileMergers().front().merge;
  Tile merged;
  merge(tiles, limits, merged);
  return merged;
}

}  // namespace splinemap
