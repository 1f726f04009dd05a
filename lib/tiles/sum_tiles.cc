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

// Sums of a row, which is one cache line of each tile, and what was touched of it.
template <typename Vector>
struct RowSums {
  static constexpr int kVectors = Tile::kSide / Vector::kCount;
  typename Vector::Sums sums[kVectors];
  typename Vector::Points touched[kVectors];
};

// Tiles whose rows are added together; null ones are zeros.
struct TileGroup {
  const Tile* const* tiles;
  size_t count;
};

inline const ControlPoint* Row(const Tile& tile, int row) {
  return tile.control_points.data() + row * Tile::kSide;
}

// These are inlined, so that each caller has them in its own instructions.
__attribute__((always_inline)) inline void Fetch(TileGroup group, int row) {
  for (size_t n = 0; n < group.count; ++n) {
    if (group.tiles[n] != nullptr) __builtin_prefetch(Row(*group.tiles[n], row));
  }
}

template <typename Vector>
__attribute__((always_inline)) inline void AddRows(TileGroup group, int row,
                                                   RowSums<Vector>& row_sums) {
  for (size_t n = 0; n < group.count; ++n) {
    if (group.tiles[n] == nullptr) continue;
    typename Vector::Points points[RowSums<Vector>::kVectors];
    std::memcpy(points, Row(*group.tiles[n], row), sizeof(points));
#pragma GCC unroll 4
    for (int k = 0; k < RowSums<Vector>::kVectors; ++k) {
      row_sums.sums[k] += __builtin_convertvector(points[k], typename Vector::Sums);
      row_sums.touched[k] |= points[k];
    }
  }
}

template <typename Vector>
__attribute__((always_inline)) inline void StoreRow(const RowSums<Vector>& row_sums,
                                                    ControlLimits limits, ControlPoint* to) {
  using Sums = typename Vector::Sums;
  const Sums min = Sums{} + limits.min;
  const Sums max = Sums{} + limits.max;
  typename Vector::Points points[RowSums<Vector>::kVectors];
#pragma GCC unroll 4
  for (int k = 0; k < RowSums<Vector>::kVectors; ++k) {
    Sums sum = row_sums.sums[k] < min ? min : row_sums.sums[k];
    sum = sum > max ? max : sum;
    sum -= sum == 0;  // a comparison that holds is -1: what was touched is never 0
    points[k] = __builtin_convertvector(sum, typename Vector::Points) & (row_sums.touched[k] != 0);
  }
  std::memcpy(to, points, sizeof(points));
}

template <typename Vector>
__attribute__((always_inline)) inline void Merge(const std::vector<const Tile*>& tiles,
                                                 ControlLimits limits, Tile& merged) {
  // No processor foresees the rows of more tiles. What they add up to stays in the fastest cache.
  constexpr size_t kAtOnce = 8;
  constexpr int kRowsAhead = 8;
  const auto group_at = [&](size_t begin) {
    begin = begin < tiles.size() ? begin : tiles.size();
    const size_t left = tiles.size() - begin;
    return TileGroup{tiles.data() + begin, left < kAtOnce ? left : kAtOnce};
  };
  RowSums<Vector> rows[Tile::kSide];
  TileGroup next = group_at(0);
  for (int row = 0; row < kRowsAhead; ++row) Fetch(next, row);
  for (size_t begin = 0; begin == 0 || begin < tiles.size(); begin += kAtOnce) {
    const TileGroup group = next;
    next = group_at(begin + kAtOnce);
    for (int row = 0; row < Tile::kSide; ++row) {
      // The first rows of the next tiles come after the last ones of these.
      const int ahead = row + kRowsAhead;
      Fetch(ahead < Tile::kSide ? group : next, ahead % Tile::kSide);
      RowSums<Vector> row_sums = begin == 0 ? RowSums<Vector>{} : rows[row];
      AddRows(group, row, row_sums);
      if (next.count == 0) {
        StoreRow(row_sums, limits, &merged.control_points[row * Tile::kSide]);
      } else {
        rows[row] = row_sums;
      }
    }
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
