// The body of a PointKernel, included by one file for each instruction set, which defines
// SPLINEMAP_KERNEL as the name of its namespace.
//
// What is called in here is local to the file or always inlined: an inline function that the linker
// took from here into the rest of the program might not run there.

#include <bit>
#include <cstddef>

#include "lib/base/kernels.h"
#include "lib/map/point_kernel.h"
#include "lib/spline/patch_kernel.h"

namespace splinemap::SPLINEMAP_KERNEL {
namespace {

static_assert(std::endian::native == std::endian::little);
static_assert(sizeof(SurfaceSample) == sizeof(Doubles4));
static_assert(offsetof(SurfaceSample, log_odds) == 16 && offsetof(SurfaceSample, known) == 24);

[[gnu::always_inline]] inline Doubles4 LoadControlPoints(const ControlPoint* row) {
#ifdef __AVX__
  return ToDoubles(reinterpret_cast<Integers4>(
      _mm_cvtepi16_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(row)))));
#else
  typedef ControlPoint ControlPoints4 __attribute__((vector_size(8)));
  return ToDoubles(__builtin_convertvector(Load<ControlPoints4>(row), Integers4));
#endif
}

void EvaluatePoint(const ControlPoint* patch, double t_x, double t_y, double knots_per_m,
                   SurfaceSample& sample) {
  Doubles4 rows[4];
  for (int row = 0; row < 4; ++row) rows[row] = LoadControlPoints(patch + Tile::kSide * row);
  const Doubles4 values = EvaluateRows(rows, t_x, t_y, kLogOddsPerUnit, knots_per_m);
  // The control point nearest to the point; rows and columns 1 and 2 are around it.
  const uint64_t known = patch[Tile::kSide * (t_y < 0.5 ? 1 : 2) + (t_x < 0.5 ? 1 : 2)] != 0;
  // At once, since a processor waits if it reads together what was written in parts.
  Store(reinterpret_cast<Words4>(values) | Words4{0, 0, 0, known}, &sample);
}

// Where four coordinates lie among the knots, as LocateKnot() has it; knot 0 for those that are off
// the map, where `all_on_map` is 0. Returns the first control points of their patches.
[[gnu::always_inline]] inline Integers4 LocateFour(Doubles4 coordinates_m, double knot_interval_m,
                                                   double* phases, Longs4& all_on_map) {
  const Doubles4 position = coordinates_m / knot_interval_m;
  const Longs4 is_on_map = (position < kMaxKnotIndex) & (position > -kMaxKnotIndex);
  const Doubles4 on_map = is_on_map ? position : Doubles4{};
  const Doubles4 index = Floor(on_map);
  Store(on_map - index, phases);
  all_on_map &= is_on_map;
  return __builtin_convertvector(index, Integers4) - 1;
}

bool Locate(const Eigen::Vector2d* points_m, double knot_interval_m, PointBlock& block) {
  Longs4 all_on_map = Longs4{} - 1;
  for (int n = 0; n < block.count; n += 4) {
    const auto low = Load<Doubles4>(points_m + n);
    const auto high = Load<Doubles4>(points_m + n + 2);
    const Doubles4 x_m = __builtin_shufflevector(low, high, 0, 2, 4, 6);
    const Doubles4 y_m = __builtin_shufflevector(low, high, 1, 3, 5, 7);
    const Integers4 i = LocateFour(x_m, knot_interval_m, &block.t_x[n], all_on_map);
    const Integers4 j = LocateFour(y_m, knot_interval_m, &block.t_y[n], all_on_map);
    const Integers4 column = i & (Tile::kSide - 1);
    const Integers4 row = j & (Tile::kSide - 1);
    Store(__builtin_shufflevector(i >> 5, j >> 5, 0, 4, 1, 5), &block.keys[n]);
    Store(__builtin_shufflevector(i >> 5, j >> 5, 2, 6, 3, 7), &block.keys[n + 2]);
    Store(row << 5 | column, &block.indices[n]);
    Store((column > Tile::kSide - 4) | (row > Tile::kSide - 4), &block.is_crossing[n]);
  }
  return (all_on_map[0] & all_on_map[1] & all_on_map[2] & all_on_map[3]) != 0;
}

#ifdef __AVX512F__
using Doubles = Doubles8;
using Words = Words8;
#else
using Doubles = Doubles4;
using Words = Words4;
#endif
constexpr int kLanes = sizeof(Doubles) / sizeof(double);

// Row `row` of the patches of the points from the first on.
[[gnu::always_inline]] inline Words LoadRows(const ControlPoint* const* patches, int row) {
  const auto of = [&](int k) { return Load<uint64_t>(patches[k] + Tile::kSide * row); };
#ifdef __AVX512F__
  return Words{of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7)};
#else
  return Words{of(0), of(1), of(2), of(3)};
#endif
}

[[gnu::always_inline]] inline void StoreSamples(const SampleOfEach<Doubles>& of_each,
                                                Words known_of_each, SurfaceSample* samples) {
#ifdef __AVX512F__
  const auto known = reinterpret_cast<Doubles>(known_of_each);
  const auto store = [&](Doubles gradients, Doubles others, int n) {
    const Doubles low = __builtin_shufflevector(gradients, others, 0, 1, 8, 9, 2, 3, 10, 11);
    const Doubles high = __builtin_shufflevector(gradients, others, 4, 5, 12, 13, 6, 7, 14, 15);
    Store(__builtin_shufflevector(low, low, 0, 1, 2, 3), &samples[n]);
    Store(__builtin_shufflevector(low, low, 4, 5, 6, 7), &samples[n + 2]);
    Store(__builtin_shufflevector(high, high, 0, 1, 2, 3), &samples[n + 4]);
    Store(__builtin_shufflevector(high, high, 4, 5, 6, 7), &samples[n + 6]);
  };
  const Doubles x = of_each.gradient_x_per_m;
  const Doubles y = of_each.gradient_y_per_m;
  const Doubles value = of_each.log_odds;
  store(__builtin_shufflevector(x, y, 0, 8, 2, 10, 4, 12, 6, 14),
        __builtin_shufflevector(value, known, 0, 8, 2, 10, 4, 12, 6, 14), 0);
  store(__builtin_shufflevector(x, y, 1, 9, 3, 11, 5, 13, 7, 15),
        __builtin_shufflevector(value, known, 1, 9, 3, 11, 5, 13, 7, 15), 1);
#else
  // Not by Eigen, nor by shuffles, which go through memory where vectors are split.
  for (int k = 0; k < kLanes; ++k) {
    auto* const to = reinterpret_cast<char*>(&samples[k]);
    Store(of_each.gradient_x_per_m[k], to);
    Store(of_each.gradient_y_per_m[k], to + 8);
    Store(of_each.log_odds[k], to + 16);
    Store(known_of_each[k], to + 24);
  }
#endif
}

void EvaluateBlock(const PointBlock& block, const PointBlock& next, double knots_per_m,
                   SurfaceSample* samples) {
  for (int n = 0; n < block.count; n += kLanes) {
    if (n < next.count) {
      for (int k = n; k < n + kLanes; ++k) {
        for (int row = 0; row < 4; ++row) {
          __builtin_prefetch(next.patches[k] + Tile::kSide * row);
        }
      }
    }
    Words rows[4];
    for (int row = 0; row < 4; ++row) rows[row] = LoadRows(&block.patches[n], row);
    const auto t_x = Load<Doubles>(&block.t_x[n]);
    const auto t_y = Load<Doubles>(&block.t_y[n]);
    const Words upper = t_y < 0.5 ? rows[1] : rows[2];
    const Words nearest = (t_x < 0.5 ? upper >> 16 : upper >> 32) & 0xffff;
    const Words known = -nearest >> 63;  // 1 where that is not 0
    StoreSamples(EvaluateRowsOfEach(rows, t_x, t_y, kLogOddsPerUnit, knots_per_m), known,
                 &samples[n]);
  }
}

}  // namespace

extern const PointKernel kPointKernel;
const PointKernel kPointKernel{SPLINEMAP_KERNEL_NAME, &EvaluatePoint, &Locate, &EvaluateBlock};

}  // namespace splinemap::SPLINEMAP_KERNEL
