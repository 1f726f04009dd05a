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
// the map, where the result is 0.
[[gnu::always_inline]] inline Longs4 LocateFour(Doubles4 coordinates_m, double knot_interval_m,
                                                int32_t* firsts, double* phases) {
  const Doubles4 position = coordinates_m / knot_interval_m;
  const Longs4 is_on_map = (position < kMaxKnotIndex) & (position > -kMaxKnotIndex);
  const Doubles4 on_map = is_on_map ? position : Doubles4{};
  const Doubles4 index = Floor(on_map);
  Store(__builtin_convertvector(index, Integers4) - 1, firsts);
  Store(on_map - index, phases);
  return is_on_map;
}

bool LocateFours(const Eigen::Vector2d* points_m, int count, double knot_interval_m,
                 PointBlock& block) {
  Longs4 all = Longs4{} - 1;
  for (int n = 0; n < count; n += 4) {
    const auto low = Load<Doubles4>(points_m + n);
    const auto high = Load<Doubles4>(points_m + n + 2);
    const Doubles4 x_m = __builtin_shufflevector(low, high, 0, 2, 4, 6);
    const Doubles4 y_m = __builtin_shufflevector(low, high, 1, 3, 5, 7);
    all &= LocateFour(x_m, knot_interval_m, &block.i[n], &block.t_x[n]);
    all &= LocateFour(y_m, knot_interval_m, &block.j[n], &block.t_y[n]);
  }
  return (all[0] & all[1] & all[2] & all[3]) != 0;
}

void EvaluateFours(const PointBlock& block, int count, double knots_per_m, SurfaceSample* samples) {
  for (int n = 0; n < count; n += 4) {
    const ControlPoint* const* const patches = &block.patches[n];
    Words4 rows[4];
    for (int row = 0; row < 4; ++row) {
      const int offset = Tile::kSide * row;
      rows[row] = Words4{Load<uint64_t>(patches[0] + offset), Load<uint64_t>(patches[1] + offset),
                         Load<uint64_t>(patches[2] + offset), Load<uint64_t>(patches[3] + offset)};
    }
    const auto t_x = Load<Doubles4>(&block.t_x[n]);
    const auto t_y = Load<Doubles4>(&block.t_y[n]);
    const Samples4 four = EvaluateRowsOf4(rows, t_x, t_y, kLogOddsPerUnit, knots_per_m);
    const Words4 upper = t_y < 0.5 ? rows[1] : rows[2];
    const Words4 nearest = (t_x < 0.5 ? upper >> 16 : upper >> 32) & 0xffff;
    const Words4 known = -nearest >> 63;  // 1 where that is not 0
    // Not by Eigen, nor by shuffles, which go through memory where vectors are split.
    for (int k = 0; k < 4; ++k) {
      auto* const to = reinterpret_cast<char*>(&samples[n + k]);
      Store(four.gradient_x_per_m[k], to);
      Store(four.gradient_y_per_m[k], to + 8);
      Store(four.log_odds[k], to + 16);
      Store(known[k], to + 24);
    }
  }
}

}  // namespace

extern const PointKernel kPointKernel;
const PointKernel kPointKernel{SPLINEMAP_KERNEL_NAME, &EvaluatePoint, &LocateFours, &EvaluateFours};

}  // namespace splinemap::SPLINEMAP_KERNEL
