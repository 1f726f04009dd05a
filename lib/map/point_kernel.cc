#include "lib/map/point_kernel.h"

#include <cstring>

#include "lib/spline/patch_kernel.h"

namespace splinemap {
namespace {

// Functions that are compiled for several kinds of instructions have to be inlined everywhere.

// The control point nearest to the point; rows and columns 1 and 2 are around it.
__attribute__((always_inline)) inline bool IsKnown(const PatchRows& rows, double t_x, double t_y) {
  return (rows[t_y < 0.5 ? 1 : 2] >> (t_x < 0.5 ? 16 : 32) & 0xffff) != 0;
}

__attribute__((always_inline)) inline void EvaluatePoint(const PatchRows& words, double t_x,
                                                         double t_y, double knots_per_m,
                                                         SurfaceSample& sample) {
  typedef ControlPoint Units __attribute__((vector_size(8)));
  Doubles4 rows[4];
  for (int row = 0; row < 4; ++row) {
    const auto units = reinterpret_cast<Units>(words[row]);
    rows[row] = __builtin_convertvector(__builtin_convertvector(units, Integers4), Doubles4);
  }
  EvaluateRows(rows, t_x, t_y, kLogOddsPerUnit, knots_per_m, sample);
  sample.known = IsKnown(words, t_x, t_y);
}

// Where four coordinates lie among the knots, as LocateKnot() has it; knot 0 for those that are off
// the map, where the result is 0.
__attribute__((always_inline)) inline Longs4 LocateFour(Doubles4 coordinates_m,
                                                        double knot_interval_m, int32_t* firsts,
                                                        double* phases) {
  const Doubles4 position = coordinates_m / knot_interval_m;
  const Longs4 is_on_map = (position < kMaxKnotIndex) & (position > -kMaxKnotIndex);
  const Doubles4 on_map = is_on_map ? position : Doubles4{};
  const Doubles4 index = Floor(on_map);
  const Integers4 first = __builtin_convertvector(index, Integers4) - 1;
  const Doubles4 phase = on_map - index;
  std::memcpy(firsts, &first, sizeof(first));
  std::memcpy(phases, &phase, sizeof(phase));
  return is_on_map;
}

// Locates whole fours; returns whether all are on the map.
__attribute__((always_inline)) inline bool LocateFours(const Eigen::Vector2d* points_m, int count,
                                                       double knot_interval_m, PointBlock& block) {
  Longs4 all = Longs4{} - 1;
  for (int n = 0; n < count; n += 4) {
    Doubles4 low;
    Doubles4 high;
    std::memcpy(&low, points_m + n, sizeof(low));
    std::memcpy(&high, points_m + n + 2, sizeof(high));
    const Doubles4 x_m = __builtin_shufflevector(low, high, 0, 2, 4, 6);
    const Doubles4 y_m = __builtin_shufflevector(low, high, 1, 3, 5, 7);
    all &= LocateFour(x_m, knot_interval_m, &block.i[n], &block.t_x[n]);
    all &= LocateFour(y_m, knot_interval_m, &block.j[n], &block.t_y[n]);
  }
  return (all[0] & all[1] & all[2] & all[3]) != 0;
}

// Evaluates whole fours.
__attribute__((always_inline)) inline void EvaluateFours(const PointBlock& block, int count,
                                                         double knots_per_m,
                                                         SurfaceSample* samples) {
  for (int n = 0; n < count; n += 4) {
    Words4 rows[4];
    for (int row = 0; row < 4; ++row) std::memcpy(&rows[row], &block.rows[row][n], sizeof(Words4));
    Doubles4 t_x;
    Doubles4 t_y;
    std::memcpy(&t_x, &block.t_x[n], sizeof(t_x));
    std::memcpy(&t_y, &block.t_y[n], sizeof(t_y));
    const Samples4 four = EvaluateRowsOf4(rows, t_x, t_y, kLogOddsPerUnit, knots_per_m);
    const Words4 upper = t_y < 0.5 ? rows[1] : rows[2];
    const Words4 nearest = (t_x < 0.5 ? upper >> 16 : upper >> 32) & 0xffff;
    for (int k = 0; k < 4; ++k) {
      samples[n + k].gradient_per_m.x() = four.gradient_x_per_m[k];
      samples[n + k].gradient_per_m.y() = four.gradient_y_per_m[k];
      samples[n + k].log_odds = four.log_odds[k];
      samples[n + k].known = nearest[k] != 0;
    }
  }
}

#define SPLINEMAP_POINT_KERNEL(name, attributes)                                                  \
  {                                                                                               \
    name,                                                                                         \
        [](const PatchRows& rows, double t_x, double t_y, double knots_per_m,                     \
           SurfaceSample& sample)                                                                 \
            attributes { EvaluatePoint(rows, t_x, t_y, knots_per_m, sample); },                   \
        [](const Eigen::Vector2d* points_m, int count, double knot_interval_m, PointBlock& block) \
            attributes { return LocateFours(points_m, count, knot_interval_m, block); },          \
        [](const PointBlock& block, int count, double knots_per_m, SurfaceSample* samples)        \
            attributes { EvaluateFours(block, count, knots_per_m, samples); }                     \
  }

constexpr PointKernel kPlain = SPLINEMAP_POINT_KERNEL("plain", );
#ifdef __x86_64__
constexpr PointKernel kAvx2 = SPLINEMAP_POINT_KERNEL("avx2", __attribute__((target("avx2"))));
constexpr PointKernel kAvx512 =
    SPLINEMAP_POINT_KERNEL("avx512", __attribute__((target("avx2,avx512f,avx512vl,avx512dq"))));
#endif

}  // namespace

const std::vector<PointKernel>& PointKernels() {
  static const std::vector<PointKernel> kernels = [] {
    std::vector<PointKernel> runnable{kPlain};
#ifdef __x86_64__
    if (__builtin_cpu_supports("avx2")) runnable.push_back(kAvx2);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512dq")) {
      runnable.push_back(kAvx512);
    }
#endif
    return runnable;
  }();
  return kernels;
}

}  // namespace splinemap
