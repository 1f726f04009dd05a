// The body of a SumKernel, included by one file for each instruction set, which defines
// SPLINEMAP_KERNEL as the name of its namespace.
//
// What is called in here is local to the file or always inlined: an inline function that the linker
// took from here into the rest of the program might not run there.

#include "lib/base/kernels.h"
#include "lib/base/lanes.h"
#include "lib/tiles/sum_kernel.h"
#ifdef SPLINEMAP_NEON
#include <arm_neon.h>
#endif

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

#ifdef SPLINEMAP_NEON

// Limits have 16 bits, and so sums may saturate before they are kept within them.
void Sum(const ControlPoint* const* tiles, size_t count, ControlLimits limits, ControlPoint* sums) {
  constexpr int kVectors = Tile::kSide / 8;
  const int16x8_t min = vdupq_n_s16(limits.min);
  const int16x8_t max = vdupq_n_s16(limits.max);
  for (int row = 0; row < Tile::kSize; row += Tile::kSide) {
    int32x4_t low[kVectors] = {};
    int32x4_t high[kVectors] = {};
    int16x8_t touched[kVectors] = {};
    for (size_t n = 0; n < count; ++n) {
      if (tiles[n] == nullptr) continue;
      const ControlPoint* first = tiles[n] + row;
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
      vst1q_s16(sums + row + 8 * k, vandq_s16(sum, vreinterpretq_s16_u16(is_touched)));
    }
  }
}

#else

// As many control points, and their sums, as vectors hold.
#ifdef __AVX512F__
constexpr int kLanes = 16;
#else
constexpr int kLanes = 8;
#endif
constexpr int kVectors = Tile::kSide / kLanes;
using Points [[gnu::vector_size(2 * kLanes)]] = int16_t;
using Sums [[gnu::vector_size(4 * kLanes)]] = int32_t;

// Sums of a row, which is one cache line of each tile, and what was touched of it.
struct RowSums {
  Sums sums[kVectors];
  Points touched[kVectors];
};

// Tiles whose rows are added together.
struct TileGroup {
  const ControlPoint* const* tiles;
  size_t count;
};

[[gnu::always_inline]] inline void Fetch(TileGroup group, int row) {
  for (size_t n = 0; n < group.count; ++n) {
    if (group.tiles[n] != nullptr) __builtin_prefetch(group.tiles[n] + row * Tile::kSide);
  }
}

[[gnu::always_inline]] inline void AddRows(TileGroup group, int row, RowSums& row_sums) {
  for (size_t n = 0; n < group.count; ++n) {
    if (group.tiles[n] == nullptr) continue;
    const ControlPoint* const first = group.tiles[n] + row * Tile::kSide;
#pragma GCC unroll 4
    for (int k = 0; k < kVectors; ++k) {
      const auto points = Load<Points>(first + k * kLanes);
      row_sums.sums[k] += __builtin_convertvector(points, Sums);
      row_sums.touched[k] |= points;
    }
  }
}

[[gnu::always_inline]] inline void StoreRow(const RowSums& row_sums, ControlLimits limits,
                                            ControlPoint* to) {
  const Sums min = Sums{} + limits.min;
  const Sums max = Sums{} + limits.max;
#pragma GCC unroll 4
  for (int k = 0; k < kVectors; ++k) {
    Sums sum = Lesser(Greater(row_sums.sums[k], min), max);
    sum -= sum == 0;  // a comparison that holds is -1: what was touched is never 0
    Store(__builtin_convertvector(sum, Points) & (row_sums.touched[k] != 0), to + k * kLanes);
  }
}

void Sum(const ControlPoint* const* tiles, size_t count, ControlLimits limits, ControlPoint* sums) {
  // No processor foresees the rows of more tiles. What they add up to stays in the fastest cache.
  constexpr size_t kAtOnce = 8;
  constexpr int kRowsAhead = 8;
  const auto group_at = [&](size_t begin) {
    begin = begin < count ? begin : count;
    const size_t left = count - begin;
    return TileGroup{tiles + begin, left < kAtOnce ? left : kAtOnce};
  };
  RowSums rows[Tile::kSide];
  TileGroup next = group_at(0);
  for (int row = 0; row < kRowsAhead; ++row) Fetch(next, row);
  for (size_t begin = 0; begin == 0 || begin < count; begin += kAtOnce) {
    const TileGroup group = next;
    next = group_at(begin + kAtOnce);
    for (int row = 0; row < Tile::kSide; ++row) {
      // The first rows of the next tiles come after the last ones of these.
      const int ahead = row + kRowsAhead;
      Fetch(ahead < Tile::kSide ? group : next, ahead % Tile::kSide);
      RowSums row_sums = begin == 0 ? RowSums{} : rows[row];
      AddRows(group, row, row_sums);
      if (next.count == 0) {
        StoreRow(row_sums, limits, sums + row * Tile::kSide);
      } else {
        rows[row] = row_sums;
      }
    }
  }
}

#endif

}  // namespace

extern const SumKernel kSumKernel;
const SumKernel kSumKernel{SPLINEMAP_KERNEL_NAME, &Sum};

}  // namespace splinemap::SPLINEMAP_KERNEL
