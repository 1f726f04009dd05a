// The body of a DistanceKernel, included by one file for each instruction set, which defines
// SPLINEMAP_KERNEL as the name of its namespace.
//
// What is called in here is local to the file or always inlined: an inline function that the linker
// took from here into the rest of the program might not run there.

#include <bit>

#include "lib/base/kernels.h"
#include "lib/base/lanes.h"
#include "lib/distance/distance_kernel.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

constexpr int kSide = VertexBlock::kSide;
constexpr int kStep = Site::kUnits;  // from vertex to vertex
typedef int16_t Halves16 __attribute__((vector_size(32)));
constexpr Integers8 kColumns{0, 1, 2, 3, 4, 5, 6, 7};

constexpr int32_t kBias = NearestOfBlock::kBias;
constexpr int32_t kNoWay = INT32_MIN;
static_assert(SiteOffset::kNone == INT16_MIN);

static_assert(std::endian::native == std::endian::little);
static_assert(sizeof(Integers8) == kSide * sizeof(SiteOffset));

[[gnu::always_inline]] inline Integers8 IsEqual(Integers8 a, Integers8 b) {
#ifdef __AVX2__
  return a == b;
#else
  return ~(IsLess(a, b) | IsLess(b, a));
#endif
}

// Of conditions, each 0 or -1, a bit for each.
[[gnu::always_inline]] inline uint32_t Bits(Integers8 conditions) {
#if defined(__AVX2__)
  return _mm256_movemask_ps(reinterpret_cast<__m256>(conditions));
#else
  uint32_t bits = 0;
  for (int k = 0; k < 8; ++k) bits |= (conditions[k] & 1) << k;
  return bits;
#endif
}

[[gnu::always_inline]] inline bool IsAny(Integers8 conditions) {
#ifdef __AVX2__
  return Bits(conditions) != 0;
#else
  const auto parts = reinterpret_cast<Words4>(conditions);
  return (parts[0] | parts[1] | parts[2] | parts[3]) != 0;
#endif
}

// The first of eight sites; a processor would wait for what is written in parts and read together.
[[gnu::always_inline]] inline Integers8 LoadSome(const Site* sites, int count) {
#ifdef __AVX2__
  const auto mask = reinterpret_cast<__m256i>(kColumns < count);
  return reinterpret_cast<Integers8>(
      _mm256_maskload_epi32(reinterpret_cast<const int*>(sites), mask));
#else
  Integers8 some{};
  for (int k = 0; k < count; ++k) some[k] = Load<int32_t>(sites + k);
  return some;
#endif
}

void Read(const SiteOffset* offsets, bool only_lost, NearestOfBlock& nearest) {
  const Integers8 none = Integers8{} + (nearest.reach_squared + 1);
  nearest.lost = 0;
  for (int y = 0; y < kSide; ++y) {
    const auto both = Load<Integers8>(offsets + Tile::kSide * y);
    const Integers8 way_x = (both << 16) >> 16;
    const Integers8 way_y = both >> 16;
    const Integers8 is_lost = IsEqual(both, Integers8{});
    const Integers8 is_none = is_lost | IsEqual(way_x, Integers8{} + SiteOffset::kNone);
    // Where there is none, its square would be too large.
    const Integers8 of_x = Select(is_none, Integers8{}, way_x);
    const Integers8 of_y = Select(is_none, Integers8{}, way_y);
    Integers8 squared = Select(is_none, none, of_x * of_x + of_y * of_y);
    if (only_lost) squared |= ~is_lost;
    nearest.lost |= uint64_t{Bits(is_lost)} << (kSide * y);
    Store(Select(is_lost, Integers8{} + kNoWay, both ^ kBias), &nearest.ways[kSide * y]);
    Store(squared, &nearest.squared[kSide * y]);
  }
}

bool Add(const Site* sites, int count, const VertexBlock& block, NearestOfBlock& nearest) {
  // A site is less far than what a vertex v has, squared, if |site|^2 - 2 v site is less than
  // that less |v|^2: what is on the left changes from row to row by the same amount.
  Integers8 limits[kSide];
  const Integers8 squared_columns = kStep * kStep * kColumns * kColumns;
  for (int y = 0; y < kSide; ++y) {
    limits[y] =
        Load<Integers8>(&nearest.squared[kSide * y]) - squared_columns - kStep * kStep * y * y;
  }
  Integers8 is_any_taken{};
  for (int k = 0; k < count; ++k) {
    const int32_t site_x = sites[k].x - kStep * block.x0;
    const int32_t site_y = sites[k].y - kStep * block.y0;
    const Integers8 first = site_x * site_x + site_y * site_y - 2 * kStep * site_x * kColumns;
    const Integers8 step = Integers8{} - 2 * kStep * site_y;
    Integers8 at = first;
    Integers8 is_near{};
    for (int y = 0; y < kSide; ++y) {
      is_near |= ~IsLess(limits[y], at);
      at += step;
    }
    if (!IsAny(is_near)) continue;
    at = first;
    const Integers8 dx = site_x - kStep * kColumns;
    Integers8 way = site_y << 16 | ((dx & 0xFFFF) ^ kBias);
    for (int y = 0; y < kSide; ++y) {
      const auto has = Load<Integers8>(&nearest.ways[kSide * y]);
      const Integers8 is_nearest =
          IsLess(at, limits[y]) | (IsEqual(at, limits[y]) & IsLess(way, has));
      is_any_taken |= is_nearest;
      Store(Select(is_nearest, way, has), &nearest.ways[kSide * y]);
      limits[y] = Select(is_nearest, at, limits[y]);
      way -= kStep << 16;
      at += step;
    }
  }
  if (!IsAny(is_any_taken)) return false;
  for (int y = 0; y < kSide; ++y) {
    Store(limits[y] + squared_columns + kStep * kStep * y * y, &nearest.squared[kSide * y]);
  }
  return true;
}

int32_t LongestSquared(const NearestOfBlock& nearest) {
  Integers8 longest{};
  for (int y = 0; y < kSide; ++y) {
    longest = Greater(longest, Load<Integers8>(&nearest.squared[kSide * y]));
  }
  int32_t longest_of_all = 0;
  for (int x = 0; x < kSide; ++x) {
    longest_of_all = longest[x] > longest_of_all ? longest[x] : longest_of_all;
  }
  return longest_of_all < nearest.reach_squared ? longest_of_all : nearest.reach_squared;
}

void Write(const NearestOfBlock& nearest, SiteOffset* offsets) {
  for (int y = 0; y < kSide; ++y) {
    Store(Load<Integers8>(&nearest.ways[kSide * y]) ^ kBias, offsets + kSide * y);
  }
}

bool TakeAway(const Site* sites, int count, const VertexBlock& block, NearestOfBlock& nearest) {
  Integers8 has[kSide];
  Integers8 is_lost[kSide]{};
  for (int y = 0; y < kSide; ++y) has[y] = Load<Integers8>(&nearest.ways[kSide * y]);
  for (int k = 0; k < count; ++k) {
    const Integers8 dx = sites[k].x - kStep * (block.x0 + kColumns);
    Integers8 way = (sites[k].y - kStep * block.y0) << 16 | ((dx & 0xFFFF) ^ kBias);
    for (int y = 0; y < kSide; ++y) {
      is_lost[y] |= IsEqual(has[y], way);
      way -= kStep << 16;
    }
  }
  Integers8 is_any_lost{};
  for (int y = 0; y < kSide; ++y) is_any_lost |= is_lost[y];
  if (!IsAny(is_any_lost)) return false;
  const Integers8 none = Integers8{} + (nearest.reach_squared + 1);
  for (int y = 0; y < kSide; ++y) {
    const auto squared = Load<Integers8>(&nearest.squared[kSide * y]);
    Store(Select(is_lost[y], Integers8{} + kBias, has[y]), &nearest.ways[kSide * y]);
    Store(Select(is_lost[y], none, squared), &nearest.squared[kSide * y]);
  }
  return true;
}

uint32_t BlocksNear(const VertexBox& box, int first, int last, const int32_t* limits) {
  const auto square_of_gap = [=](Integers8 blocks, int low, int high)
      __attribute__((always_inline)) {
    const Integers8 at = kSide * kStep * blocks;
    const Integers8 gap = Greater(Greater(at + (first - high), low - last - at), Integers8{});
    return gap * gap;
  };
  const Integers8 x = square_of_gap(kColumns & 3, box.low.x, box.high.x);
  uint32_t near = 0;
  for (int half = 0; half < 2; ++half) {
    const Integers8 y = square_of_gap((kColumns >> 2) + 2 * half, box.low.y, box.high.y);
    near |= (~Bits(IsLess(Load<Integers8>(limits + 8 * half), x + y)) & 0xFF) << (8 * half);
  }
  return near;
}

// Of vectors whose x and y are the halves of each number: x_a x_b + y_a y_b.
[[gnu::always_inline]] inline Integers8 ScalarProducts(Halves16 a, Halves16 b) {
#if defined(__AVX2__)
  return reinterpret_cast<Integers8>(
      _mm256_madd_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
#else
  const auto x_and_y_a = reinterpret_cast<Integers8>(a);
  const auto x_and_y_b = reinterpret_cast<Integers8>(b);
  return ((x_and_y_a << 16) >> 16) * ((x_and_y_b << 16) >> 16) +
         (x_and_y_a >> 16) * (x_and_y_b >> 16);
#endif
}

[[gnu::always_inline]] inline Halves16 Pairs(int32_t x, int32_t y) {
  return reinterpret_cast<Halves16>(Integers8{} + (y << 16 | (x & 0xFFFF)));
}

#ifdef __AVX2__
// By bits, the numbers of those that are set, a byte for each.
constexpr auto kNumbersOfBits = [] {
  struct {
    uint64_t of[256]{};
  } numbers;
  for (int bits = 0; bits < 256; ++bits) {
    int count = 0;
    for (uint64_t k = 0; k < 8; ++k) {
      if ((bits >> k & 1) != 0) numbers.of[bits] |= k << (8 * count++);
    }
  }
  return numbers;
}();
#endif

// Copies those whose bits are set, and what comes after them is written over.
[[gnu::always_inline]] inline void StoreSome(Integers8 sites, uint32_t bits, Site* to) {
#ifdef __AVX2__
  const __m256i numbers = _mm256_cvtepu8_epi32(
      _mm_loadl_epi64(reinterpret_cast<const __m128i*>(&kNumbersOfBits.of[bits])));
  Store(_mm256_permutevar8x32_epi32(reinterpret_cast<__m256i>(sites), numbers), to);
#else
  for (; bits != 0; bits &= bits - 1) Store(int32_t{sites[__builtin_ctz(bits)]}, to++);
#endif
}

int KeepNotHidden(const Site* sites, int count, const VertexBox& box, const Site& other,
                  Site* kept) {
  // |v - site|^2 - |v - other|^2 is linear in v: over the box it is at most so much less than at
  // its middle. There it is (site - other) (site + other - 2 middle), with numbers of 16 bits,
  // since neither is farther from the box than a field reaches.
  const Halves16 others = Pairs(other.x, other.y);
  const Halves16 to_other =
      Pairs(other.x - box.low.x - box.high.x, other.y - box.low.y - box.high.y);
  const Halves16 extent = Pairs(box.high.x - box.low.x, box.high.y - box.low.y);
  int num_kept = 0;
  for (int begin = 0; begin < count; begin += kSide) {
    const Site* some = sites + begin;
    const int num_some = count - begin < kSide ? count - begin : kSide;
    const auto both = reinterpret_cast<Halves16>(num_some == kSide ? Load<Integers8>(some)
                                                                   : LoadSome(some, num_some));
    const Halves16 apart = both - others;
    const Integers8 slack = ScalarProducts(Greater(apart, -apart), extent);
    const Integers8 farther = ScalarProducts(apart, both + to_other);
    const uint32_t bits = ~Bits(IsLess(slack, farther)) & ((1u << num_some) - 1);
    StoreSome(reinterpret_cast<Integers8>(both), bits, kept + num_kept);
    num_kept += __builtin_popcount(bits);
  }
  return num_kept;
}

// The most by which what has these control points along an axis bends down: its second derivative
// lies between their second differences.
[[gnu::always_inline]] inline void AddBend(const Integers8 (&c)[4], Integers8& bend) {
  bend = Greater(bend, 2 * c[1] - c[0] - c[2]);
  bend = Greater(bend, 2 * c[2] - c[1] - c[3]);
}

// 6 times a Bezier net of what has these control points along an axis.
[[gnu::always_inline]] inline void SetSixfoldNet(const Integers8 (&c)[4], Integers8 (&net)[4]) {
  net[0] = c[0] + 4 * c[1] + c[2];
  net[1] = 4 * c[1] + 2 * c[2];
  net[2] = 2 * c[1] + 4 * c[2];
  net[3] = c[1] + 4 * c[2] + c[3];
}

void FindRanges(const ControlPoint* first, int stride, CellRanges& ranges) {
  typedef ControlPoint ControlPoints8 __attribute__((vector_size(16)));
  Integers8 along_y[4][4];  // by column
  Integers8 bend_y{};
  for (int x = 0; x < 4; ++x) {
    Integers8 column[4];
    for (int y = 0; y < 4; ++y) {
      const auto points = Load<ControlPoints8>(first + stride * y + x);
      column[y] = __builtin_convertvector(points, Integers8);
    }
    AddBend(column, bend_y);
    SetSixfoldNet(column, along_y[x]);
  }
  Integers8 bend_x{};
  Integers8 least = Integers8{} + INT32_MAX;
  Integers8 greatest = Integers8{} + INT32_MIN;
  for (int y = 0; y < 4; ++y) {
    const Integers8 row[4] = {along_y[0][y], along_y[1][y], along_y[2][y], along_y[3][y]};
    Integers8 net[4];
    AddBend(row, bend_x);
    SetSixfoldNet(row, net);
    for (int k = 0; k < 4; ++k) {
      least = Lesser(least, net[k]);
      greatest = Greater(greatest, net[k]);
    }
  }
  Store(least, ranges.least);
  Store(greatest, ranges.greatest);
  Store(6 * bend_y + bend_x, ranges.bend);
}

SquaresWithCorner FindCorners(const ControlPoint* patch, double high, double higher) {
  typedef ControlPoint ControlPoints4 __attribute__((vector_size(8)));
  Doubles4 rows[4];
  for (int y = 0; y < 4; ++y) {
    rows[y] = ToDoubles(__builtin_convertvector(Load<ControlPoints4>(patch + 4 * y), Integers4));
  }
  // Of each row of corners, what is greater of those on the left and on the right of a square.
  Doubles4 greater[5];
  for (int y = 0; y < 5; ++y) {
    Doubles4 at{};
    for (int k = 0; k < 4; ++k) at += kNetWeights[k][3 * y] * rows[k];
    Doubles4 left{};
    Doubles4 right{};
    for (int k = 0; k < 4; ++k) {
      const double* w = kNetWeights[k];
      left += at[k] * Doubles4{w[0], w[3], w[6], w[9]};
      right += at[k] * Doubles4{w[3], w[6], w[9], w[12]};
    }
    greater[y] = Greater(left, right);
  }
  Longs4 is_high{};
  Longs4 is_higher{};
  for (int y = 0; y < 4; ++y) {
    const Doubles4 greatest = Greater(greater[y], greater[y + 1]);
    const Longs4 bits = Longs4{1, 2, 4, 8} << (4 * y);
    is_high |= ~IsLess(greatest, Doubles4{} + high) & bits;
    is_higher |= ~IsLess(greatest, Doubles4{} + higher) & bits;
  }
  return {static_cast<uint32_t>(is_high[0] | is_high[1] | is_high[2] | is_high[3]),
          static_cast<uint32_t>(is_higher[0] | is_higher[1] | is_higher[2] | is_higher[3])};
}

void FindNet(const ControlPoint* patch, int x, int y, double* net) {
  Doubles4 columns[4];
  for (int row = 0; row < 4; ++row) {
    columns[row] = Doubles4{};
    for (int k = 0; k < 4; ++k) {
      columns[row] +=
          static_cast<double>(patch[4 * row + k]) * Load<Doubles4>(&kNetWeights[k][3 * x]);
    }
  }
  for (int k = 0; k < 4; ++k) {
    Doubles4 points{};
    for (int row = 0; row < 4; ++row) points += kNetWeights[row][3 * y + k] * columns[row];
    Store(points, net + 4 * k);
  }
}

}  // namespace

extern const DistanceKernel kDistanceKernel;
const DistanceKernel kDistanceKernel{
    SPLINEMAP_KERNEL_NAME, &Read,          &Add,        &LongestSquared, &Write,  &TakeAway,
    &BlocksNear,           &KeepNotHidden, &FindRanges, &FindCorners,    &FindNet};

}  // namespace splinemap::SPLINEMAP_KERNEL
