#include "lib/distance/nearest_sites.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>

#include "splinemap/tile.h"

namespace splinemap {
namespace {

constexpr int kSide = VertexBlock::kSide;
constexpr int kStep = Site::kUnits;  // from vertex to vertex
constexpr Integers8 kColumns{0, 1, 2, 3, 4, 5, 6, 7};

// An offset as the number of these bits, but for the highest of x: so it is less by y, then by x.
constexpr int32_t kBias = 1 << 15;
constexpr int32_t kNoWay = std::numeric_limits<int32_t>::min();
static_assert(SiteOffset::kNone == INT16_MIN);

static_assert(std::endian::native == std::endian::little);
static_assert(sizeof(Integers8) == kSide * sizeof(SiteOffset));
static_assert(kLost == SiteOffset{0, 0});

// Of conditions, each 0 or -1.
SPLINEMAP_INLINE bool IsAny(const Integers8& conditions) {
  uint64_t parts[4];
  std::memcpy(parts, &conditions, sizeof(parts));
  return (parts[0] | parts[1] | parts[2] | parts[3]) != 0;
}

SPLINEMAP_INLINE bool TakeEachAway(absl::Span<const Site> sites, const VertexBlock& block,
                                   const SiteOffset* offsets, BlockOffsets& without) {
  std::array<Integers8, kSide> has;
  std::array<Integers8, kSide> stays;
  for (int y = 0; y < kSide; ++y) {
    std::memcpy(&has[y], offsets + Tile::kSide * y, sizeof(has[y]));
    stays[y] = Integers8{} - 1;
  }
  for (const Site& site : sites) {
    // From row to row the way is one knot interval shorter.
    const Integers8 dx = site.x - kStep * (block.x0 + kColumns);
    Integers8 way = (site.y - kStep * block.y0) << 16 | (dx & 0xFFFF);
    for (int y = 0; y < kSide; ++y) {
      stays[y] &= has[y] != way;
      way -= kStep << 16;
    }
  }
  Integers8 is_any_lost{};
  for (int y = 0; y < kSide; ++y) {
    is_any_lost |= ~stays[y];
    has[y] &= stays[y];
  }
  std::memcpy(static_cast<void*>(&without), &has, sizeof(without));
  return IsAny(is_any_lost);
}

// Copies them to `kept`; says how many.
SPLINEMAP_INLINE size_t KeepNotHidden(absl::Span<const Site> sites, const VertexBox& box,
                                      const Site& other, Site* kept) {
  // |v - site|^2 - |v - other|^2 is linear in v: over the box it is at most so much less than at
  // its middle.
  const int32_t middle_x = box.low.x + box.high.x;  // twice that
  const int32_t middle_y = box.low.y + box.high.y;
  const int32_t width = box.high.x - box.low.x;
  const int32_t height = box.high.y - box.low.y;
  const int32_t to_other = other.x * (other.x - middle_x) + other.y * (other.y - middle_y);
  size_t num_kept = 0;
  for (size_t begin = 0; begin < sites.size(); begin += kSide) {
    const size_t count = std::min<size_t>(kSide, sites.size() - begin);
    const Site* some = &sites[begin];
    Integers8 both{};
    if (count == kSide) {
      std::memcpy(&both, some, sizeof(both));
    } else {
      for (size_t k = 0; k < count; ++k) both[k] = some[k].y << 16 | (some[k].x & 0xFFFF);
    }
    const Integers8 x = (both << 16) >> 16;
    const Integers8 y = both >> 16;
    const Integers8 dx = x - other.x;
    const Integers8 dy = y - other.y;
    const Integers8 slack = width * (dx < 0 ? -dx : dx) + height * (dy < 0 ? -dy : dy);
    const Integers8 farther = x * (x - middle_x) + y * (y - middle_y) - to_other;
    const Integers8 is_kept = ~(farther > slack);
    int32_t keeps[kSide];
    std::memcpy(keeps, &is_kept, sizeof(keeps));
    for (size_t k = 0; k < count; ++k) {
      kept[num_kept] = some[k];
      num_kept += keeps[k] & 1;
    }
  }
  return num_kept;
}

}  // namespace

struct NearestSitesKernel {
  SPLINEMAP_INLINE static void Read(NearestSites::Of vertices, const SiteOffset* offsets,
                                    NearestSites& nearest) {
    for (int y = 0; y < kSide; ++y) {
      Integers8 both;
      std::memcpy(&both, offsets + Tile::kSide * y, sizeof(both));
      const Integers8 is_lost = both == 0;
      const Integers8 way_x = (both << 16) >> 16;
      const Integers8 way_y = both >> 16;
      Integers8 squared = way_x * way_x + way_y * way_y;
      const Integers8 is_none = is_lost | (way_x == SiteOffset::kNone);
      squared = is_none ? Integers8{} + (nearest.reach_squared_ + 1) : squared;
      if (vertices == NearestSites::Of::kLostOnes) squared = is_lost ? squared : -1;
      nearest.ways_[y] = is_lost ? Integers8{} + kNoWay : both ^ kBias;
      nearest.squared_[y] = squared;
    }
  }

  SPLINEMAP_INLINE static bool Add(absl::Span<const Site> sites, const VertexBlock& block,
                                   NearestSites& nearest) {
    // A site is less far than what a vertex v has, squared, if |site|^2 - 2 v site is less than
    // that less |v|^2: what is on the left changes from row to row by the same amount.
    std::array<Integers8, kSide> limits;
    const Integers8 squared_columns = kStep * kStep * kColumns * kColumns;
    for (int y = 0; y < kSide; ++y) {
      limits[y] = nearest.squared_[y] - squared_columns - kStep * kStep * y * y;
    }
    bool is_any_taken = false;
    for (const Site& site : sites) {
      const int32_t site_x = site.x - kStep * block.x0;
      const int32_t site_y = site.y - kStep * block.y0;
      const Integers8 first = site_x * site_x + site_y * site_y - 2 * kStep * site_x * kColumns;
      const Integers8 step = Integers8{} - 2 * kStep * site_y;
      Integers8 at = first;
      Integers8 is_far = Integers8{} - 1;
      for (int y = 0; y < kSide; ++y) {
        is_far &= at > limits[y];
        at += step;
      }
      if (!IsAny(~is_far)) continue;
      at = first;
      const Integers8 dx = site_x - kStep * kColumns;
      Integers8 way = site_y << 16 | ((dx & 0xFFFF) ^ kBias);
      Integers8 is_taken{};
      for (int y = 0; y < kSide; ++y) {
        Integers8& has = nearest.ways_[y];
        const Integers8 is_nearest = (at < limits[y]) | ((at == limits[y]) & (way < has));
        is_taken |= is_nearest;
        has = is_nearest ? way : has;
        limits[y] = is_nearest ? at : limits[y];
        way -= kStep << 16;
        at += step;
      }
      is_any_taken = is_any_taken || IsAny(is_taken);
    }
    if (!is_any_taken) return false;
    for (int y = 0; y < kSide; ++y) {
      nearest.squared_[y] = limits[y] + squared_columns + kStep * kStep * y * y;
    }
    return true;
  }
};

namespace {

#ifdef __x86_64__
__attribute__((target("avx2"))) bool TakeAwayByAvx2(absl::Span<const Site> sites,
                                                    const VertexBlock& block,
                                                    const SiteOffset* offsets,
                                                    BlockOffsets& without) {
  return TakeEachAway(sites, block, offsets, without);
}

__attribute__((target("avx2"))) size_t KeepNotHiddenByAvx2(absl::Span<const Site> sites,
                                                           const VertexBox& box, const Site& other,
                                                           Site* kept) {
  return KeepNotHidden(sites, box, other, kept);
}

__attribute__((target("avx2"))) void ReadByAvx2(NearestSites::Of vertices,
                                                const SiteOffset* offsets, NearestSites& nearest) {
  NearestSitesKernel::Read(vertices, offsets, nearest);
}

__attribute__((target("avx2"))) bool AddByAvx2(absl::Span<const Site> sites,
                                               const VertexBlock& block, NearestSites& nearest) {
  return NearestSitesKernel::Add(sites, block, nearest);
}
#endif

}  // namespace

bool TakeAway(absl::Span<const Site> sites, const VertexBlock& block, const SiteOffset* offsets,
              BlockOffsets& without) {
#ifdef __x86_64__
  if (has_avx2) return TakeAwayByAvx2(sites, block, offsets, without);
#endif
  return TakeEachAway(sites, block, offsets, without);
}

absl::Span<const Site> SomeSites::NotHidden(absl::Span<const Site> sites, const VertexBox& box,
                                            const Site& other) {
#ifdef __x86_64__
  if (has_avx2) return {kept_.data(), KeepNotHiddenByAvx2(sites, box, other, kept_.data())};
#endif
  return {kept_.data(), KeepNotHidden(sites, box, other, kept_.data())};
}

NearestSites::NearestSites(Of vertices, const SiteOffset* offsets, int32_t reach_squared)
    : reach_squared_(reach_squared) {
#ifdef __x86_64__
  if (has_avx2) {
    ReadByAvx2(vertices, offsets, *this);
    return;
  }
#endif
  NearestSitesKernel::Read(vertices, offsets, *this);
}

bool NearestSites::Add(absl::Span<const Site> sites, const VertexBlock& block) {
#ifdef __x86_64__
  if (has_avx2) return AddByAvx2(sites, block, *this);
#endif
  return AddPlainly(sites, block);
}

bool NearestSites::AddPlainly(absl::Span<const Site> sites, const VertexBlock& block) {
  return NearestSitesKernel::Add(sites, block, *this);
}

int32_t NearestSites::LongestSquared() const {
  Integers8 longest{};
  for (const Integers8& squared : squared_) longest = squared > longest ? squared : longest;
  int32_t longest_of_all = 0;
  for (int x = 0; x < kSide; ++x) longest_of_all = std::max(longest_of_all, longest[x]);
  return std::min(longest_of_all, reach_squared_);
}

SiteOffset NearestSites::OffsetOf(int vertex) const {
  const int32_t both = ways_[vertex / kSide][vertex % kSide] ^ kBias;
  return {static_cast<int16_t>(both & 0xFFFF), static_cast<int16_t>(both >> 16)};
}

BlockOffsets NearestSites::Offsets() const {
  BlockOffsets offsets;
  for (int y = 0; y < kSide; ++y) {
    const Integers8 both = ways_[y] ^ kBias;
    std::memcpy(static_cast<void*>(&offsets[kSide * y]), &both, sizeof(both));
  }
  return offsets;
}

}  // namespace splinemap
