#include "lib/distance/nearest_sites.h"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <cstring>
#include <limits>

#include "splinemap/tile.h"

namespace splinemap {
namespace {

#define SPLINEMAP_INLINE __attribute__((always_inline)) inline

typedef int32_t Integers8 __attribute__((vector_size(32)));

constexpr int kSide = VertexBlock::kSide;
constexpr Integers8 kColumns{0, 1, 2, 3, 4, 5, 6, 7};

struct Scratch {
  std::vector<int32_t>& squared;
  std::vector<uint8_t>& is_kept;
};

// Leaves out sites that are nearest to no point of the block, whatever others there are: of two
// sites, one whose side of their bisector has nothing of the block. Says which is the first of
// those that are nearest to its centre.
SPLINEMAP_INLINE Site LeaveOutHidden(Sites& sites, const VertexBlock& block, Scratch scratch) {
  constexpr int32_t kHalf = Site::kUnits * (kSide - 1) / 2;
  const int32_t centre_x = Site::kUnits * block.x0 + kHalf;
  const int32_t centre_y = Site::kUnits * block.y0 + kHalf;
  const size_t count = sites.size;
  if (scratch.squared.size() < count) {
    scratch.squared.resize(2 * count);
    scratch.is_kept.resize(2 * count + sizeof(uint64_t));
  }
  int32_t* x = sites.x.data();
  int32_t* y = sites.y.data();
  int32_t* squared = scratch.squared.data();
  uint8_t* is_kept = scratch.is_kept.data();
  int32_t least = std::numeric_limits<int32_t>::max();
  for (size_t k = 0; k < count; ++k) {
    const int32_t dx = x[k] - centre_x;
    const int32_t dy = y[k] - centre_y;
    squared[k] = dx * dx + dy * dy;
    least = squared[k] < least ? squared[k] : least;
  }
  const auto first = std::find(squared, squared + count, least) - squared;
  const Site best{x[first], y[first]};
  // |v - site|^2 - |v - best|^2 is linear in v: over the block it is at most so much less than at
  // the centre.
  for (size_t k = 0; k < count; ++k) {
    const int32_t slack = 2 * kHalf * (std::abs(x[k] - best.x) + std::abs(y[k] - best.y));
    is_kept[k] = squared[k] - least <= slack ? 1 : 0;
  }
  // Eight at once, since most are left out.
  size_t num_kept = 0;
  std::memset(is_kept + count, 0, sizeof(uint64_t));
  for (size_t k = 0; k < count; k += sizeof(uint64_t)) {
    uint64_t eight;
    std::memcpy(&eight, is_kept + k, sizeof(eight));
    for (; eight != 0; eight &= eight - 1) {
      const size_t n = k + std::countr_zero(eight) / 8;
      x[num_kept] = x[n];
      y[num_kept] = y[n];
      ++num_kept;
    }
  }
  sites.size = num_kept;
  return best;
}

SPLINEMAP_INLINE std::array<Site, VertexBlock::kSize> FindNearest(Sites& sites,
                                                                  const VertexBlock& block,
                                                                  Scratch scratch) {
  const Site best = LeaveOutHidden(sites, block, scratch);
  // How much farther a site is than `best`, squared: it changes from vertex to vertex by the same
  // amount, and is a multiple of 8, since the square of an odd number is one more than that. An
  // eighth of it is below 14 (|dx| + |dy|), so that there is room for a number beside it.
  constexpr int kNumberBits = 10;
  constexpr size_t kChunk = 1 << kNumberBits;
  constexpr int32_t kMax = std::numeric_limits<int32_t>::max();
  struct Ranks {
    alignas(32) std::array<int32_t, kChunk> first;  // at the block's first vertex
    alignas(32) std::array<int32_t, kChunk> step_x;
    alignas(32) std::array<int32_t, kChunk> step_y;
  } ranks;
  const int32_t to_best_x = best.x - Site::kUnits * block.x0;
  const int32_t to_best_y = best.y - Site::kUnits * block.y0;
  std::array<Site, VertexBlock::kSize> nearest;
  std::array<int32_t, VertexBlock::kSize> least_so_far;
  for (size_t begin = 0; begin < sites.size; begin += kChunk) {
    const auto count = static_cast<int32_t>(std::min(kChunk, sites.size - begin));
    const int32_t* x = &sites.x[begin];
    const int32_t* y = &sites.y[begin];
    for (int32_t k = 0; k < count; ++k) {
      const int32_t dx = x[k] - best.x;
      const int32_t dy = y[k] - best.y;
      const int32_t farther = dx * (2 * to_best_x + dx) + dy * (2 * to_best_y + dy);
      ranks.first[k] = (farther >> 3) * static_cast<int32_t>(kChunk) + k;
      ranks.step_x[k] = -2 * dx * static_cast<int32_t>(kChunk);
      ranks.step_y[k] = -2 * dy * static_cast<int32_t>(kChunk);
    }
    for (int half = 0; half < 2; ++half) {
      constexpr int kRows = kSide / 2;
      std::array<Integers8, kRows> least;
      least.fill(Integers8{} + kMax);
      for (int32_t k = 0; k < count; ++k) {
        Integers8 rank =
            ranks.first[k] + kRows * half * ranks.step_y[k] + ranks.step_x[k] * kColumns;
        for (Integers8& least_of_row : least) {
          least_of_row = rank < least_of_row ? rank : least_of_row;
          rank += ranks.step_y[k];
        }
      }
      for (int n = 0; n < kRows * kSide; ++n) {
        const int vertex = kRows * kSide * half + n;
        const int32_t rank = least[n / kSide][n % kSide];
        if (begin > 0 && rank >> kNumberBits >= least_so_far[vertex]) continue;
        const int32_t k = rank & static_cast<int32_t>(kChunk - 1);
        least_so_far[vertex] = rank >> kNumberBits;
        nearest[vertex] = {x[k], y[k]};
      }
    }
  }
  return nearest;
}

SPLINEMAP_INLINE int32_t CopySites(const int32_t* from_x, const int32_t* from_y, size_t count,
                                   const Site& shift, const Site& centre, int32_t* to_x,
                                   int32_t* to_y) {
  int32_t least = std::numeric_limits<int32_t>::max();
  for (size_t k = 0; k < count; ++k) {
    to_x[k] = from_x[k] + shift.x;
    to_y[k] = from_y[k] + shift.y;
    const int32_t dx = to_x[k] - centre.x;
    const int32_t dy = to_y[k] - centre.y;
    const int32_t squared = dx * dx + dy * dy;
    least = squared < least ? squared : least;
  }
  return least;
}

// The offsets of 8 vertices in a row.
struct OffsetRow {
  Integers8 x;
  Integers8 y;
  Integers8 squared;
};

SPLINEMAP_INLINE OffsetRow Read(const SiteOffset* offsets, int32_t squared_of_none) {
  static_assert(std::endian::native == std::endian::little);
  Integers8 both;
  static_assert(sizeof(both) == kSide * sizeof(SiteOffset));
  std::memcpy(&both, offsets, sizeof(both));
  OffsetRow row{(both << 16) >> 16, both >> 16, {}};
  const Integers8 is_none = row.x == SiteOffset::kNone;
  row.squared =
      is_none ? Integers8{} + squared_of_none : row.x * row.x + (is_none ? 0 : row.y * row.y);
  return row;
}

SPLINEMAP_INLINE bool IsAny(const Integers8& conditions) {
  uint64_t parts[4];
  std::memcpy(parts, &conditions, sizeof(parts));
  return (parts[0] | parts[1] | parts[2] | parts[3]) != 0;
}

SPLINEMAP_INLINE bool FindAny(absl::Span<const Site> sites, const VertexBlock& block,
                              const SiteOffset* offsets) {
  std::array<Integers8, kSide> has;
  for (int y = 0; y < kSide; ++y) std::memcpy(&has[y], offsets + Tile::kSide * y, sizeof(has[y]));
  Integers8 is_any{};
  for (const Site& site : sites) {
    const Integers8 dx = site.x - Site::kUnits * (block.x0 + kColumns);
    for (int y = 0; y < kSide; ++y) {
      const int32_t dy = site.y - Site::kUnits * (block.y0 + y);
      is_any |= has[y] == (dy << 16 | (dx & 0xFFFF));
    }
  }
  return IsAny(is_any);
}

SPLINEMAP_INLINE WithSites AddEach(absl::Span<const Site> sites, const VertexBlock& block,
                                   const SiteOffset* offsets, int32_t reach_squared) {
  std::array<OffsetRow, kSide> rows;
  for (int y = 0; y < kSide; ++y) rows[y] = Read(offsets + Tile::kSide * y, reach_squared + 1);
  WithSites result;
  for (const Site& site : sites) {
    const Integers8 dx = site.x - Site::kUnits * (block.x0 + kColumns);
    const Integers8 squares_x = dx * dx;
    std::array<Integers8, kSide> squared;
    Integers8 is_any_near{};
    for (int y = 0; y < kSide; ++y) {
      const int32_t dy = site.y - Site::kUnits * (block.y0 + y);
      squared[y] = squares_x + dy * dy;
      is_any_near |= squared[y] <= rows[y].squared;
    }
    if (!IsAny(is_any_near)) continue;
    Integers8 is_any_nearer{};
    Integers8 is_any_as_near{};
    for (int y = 0; y < kSide; ++y) {
      OffsetRow& row = rows[y];
      const Integers8 is_nearer = squared[y] < row.squared;
      is_any_nearer |= is_nearer;
      is_any_as_near |= squared[y] == row.squared;
      row.x = is_nearer ? dx : row.x;
      row.y = is_nearer ? Integers8{} + (site.y - Site::kUnits * (block.y0 + y)) : row.y;
      row.squared = is_nearer ? squared[y] : row.squared;
    }
    result.is_any_nearer = result.is_any_nearer || IsAny(is_any_nearer);
    result.is_any_as_near = IsAny(is_any_as_near);
    if (result.is_any_as_near) return result;
  }
  if (!result.is_any_nearer) return result;
  Integers8 longest{};
  for (int y = 0; y < kSide; ++y) {
    longest = rows[y].squared > longest ? rows[y].squared : longest;
    const Integers8 both = rows[y].y << 16 | (rows[y].x & 0xFFFF);
    std::memcpy(static_cast<void*>(&result.offsets[kSide * y]), &both, sizeof(both));
  }
  for (int x = 0; x < kSide; ++x) {
    result.longest_squared = std::max(result.longest_squared, std::min(longest[x], reach_squared));
  }
  return result;
}

#ifdef __x86_64__
const bool has_avx2 = __builtin_cpu_supports("avx2");

__attribute__((target("avx2"))) int32_t CopySitesByAvx2(const int32_t* from_x,
                                                        const int32_t* from_y, size_t count,
                                                        const Site& shift, const Site& centre,
                                                        int32_t* to_x, int32_t* to_y) {
  return CopySites(from_x, from_y, count, shift, centre, to_x, to_y);
}

__attribute__((target("avx2"))) bool FindAnyByAvx2(absl::Span<const Site> sites,
                                                   const VertexBlock& block,
                                                   const SiteOffset* offsets) {
  return FindAny(sites, block, offsets);
}

__attribute__((target("avx2"))) WithSites AddEachByAvx2(absl::Span<const Site> sites,
                                                        const VertexBlock& block,
                                                        const SiteOffset* offsets,
                                                        int32_t reach_squared) {
  return AddEach(sites, block, offsets, reach_squared);
}

__attribute__((target("avx2"))) std::array<Site, VertexBlock::kSize> FindNearestByAvx2(
    Sites& sites, const VertexBlock& block, Scratch scratch) {
  return FindNearest(sites, block, scratch);
}
#endif

}  // namespace

int32_t AddSites(const Sites& others, size_t begin, size_t end, const Site& shift,
                 const Site& centre, Sites& sites) {
  const size_t size = sites.size;
  const size_t count = end - begin;
  sites.Add(count);
  const int32_t* x = &others.x[begin];
  const int32_t* y = &others.y[begin];
#ifdef __x86_64__
  if (has_avx2) {
    return CopySitesByAvx2(x, y, count, shift, centre, &sites.x[size], &sites.y[size]);
  }
#endif
  return CopySites(x, y, count, shift, centre, &sites.x[size], &sites.y[size]);
}

bool HasAny(absl::Span<const Site> sites, const VertexBlock& block, const SiteOffset* offsets) {
#ifdef __x86_64__
  if (has_avx2) return FindAnyByAvx2(sites, block, offsets);
#endif
  return FindAny(sites, block, offsets);
}

WithSites AddToBlock(absl::Span<const Site> sites, const VertexBlock& block,
                     const SiteOffset* offsets, int32_t reach_squared) {
#ifdef __x86_64__
  if (has_avx2) return AddEachByAvx2(sites, block, offsets, reach_squared);
#endif
  return AddEach(sites, block, offsets, reach_squared);
}

NearestSites::Nearest NearestSites::Find(Sites& sites, const VertexBlock& block) {
#ifdef __x86_64__
  if (has_avx2) return FindNearestByAvx2(sites, block, {squared_, is_kept_});
#endif
  return FindPlainly(sites, block);
}

NearestSites::Nearest NearestSites::FindPlainly(Sites& sites, const VertexBlock& block) {
  return FindNearest(sites, block, {squared_, is_kept_});
}

}  // namespace splinemap
