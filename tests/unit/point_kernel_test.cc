#include "lib/map/point_kernel.h"

#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <random>

namespace splinemap::point_kernel_test {

constexpr double kKnot = 0.05;

void ExpectSame(const SurfaceSample& sample, const SurfaceSample& expected) {
  // Bytes, so that zeros have the same sign.
  ASSERT_EQ(std::bit_cast<uint64_t>(sample.log_odds), std::bit_cast<uint64_t>(expected.log_odds));
  for (int k = 0; k < 2; ++k) {
    ASSERT_EQ(std::bit_cast<uint64_t>(sample.gradient_per_m[k]),
              std::bit_cast<uint64_t>(expected.gradient_per_m[k]));
  }
  ASSERT_EQ(sample.known, expected.known);
}

// By the plain code for control points in log-odds.
SurfaceSample Expected(const ControlPoint* units, double t_x, double t_y) {
  ControlPatch patch;
  for (int k = 0; k < 16; ++k) {
    patch(k / 4, k % 4) = units[Tile::kSide * (k / 4) + k % 4] / double{kUnitsPerLogOdds};
  }
  SurfaceSample sample = EvaluatePatch(patch, t_x, t_y, kKnot);
  sample.known = patch(t_y < 0.5 ? 1 : 2, t_x < 0.5 ? 1 : 2) != 0;
  return sample;
}

TEST(PointKernelTest, EveryKernelEvaluatesToTheBytesOfThePlainCode) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> phase(0, 1);
  std::uniform_int_distribution<int> place(0, Tile::kSide - 4);
  for (const PointKernel& kernel : PointKernels()) {
    SCOPED_TRACE(kernel.name);
    for (int repetition = 0; repetition < 100; ++repetition) {
      // Some control points are 0, and all bits of the others random.
      Tile tile;
      for (ControlPoint& c : tile.control_points) {
        c = random() % 5 == 0 ? 0 : static_cast<ControlPoint>(random());
      }
      PointBlock block;
      block.count = PointBlock::kSize;
      for (int n = 0; n < PointBlock::kSize; ++n) {
        const int column = place(random);
        block.patches[n] = &tile.control_points[IndexInTile(column, place(random))];
        block.t_x[n] = n % 9 == 0 ? 0 : phase(random);
        block.t_y[n] = n % 7 == 0 ? 0.5 : phase(random);
      }
      std::array<SurfaceSample, PointBlock::kSize> samples;
      kernel.evaluate(block, PointBlock(), 1 / kKnot, samples.data());
      for (int n = 0; n < PointBlock::kSize; ++n) {
        const ControlPoint* const patch = block.patches[n];
        const SurfaceSample expected = Expected(patch, block.t_x[n], block.t_y[n]);
        ExpectSame(samples[n], expected);
        SurfaceSample one;
        kernel.evaluate_point(patch, block.t_x[n], block.t_y[n], 1 / kKnot, one);
        ExpectSame(one, expected);
      }
    }
  }
}

TEST(PointKernelTest, EveryKernelLocatesPointsAsLocateKnotDoes) {
  const double kNan = std::nan("");
  const double kInfinity = std::numeric_limits<double>::infinity();
  const double kEdge_m = kMaxKnotIndex * kKnot;
  const std::vector<double> special_m = {0,         -0.0,       kKnot,       -kKnot,     1e-300,
                                         -1e-300,   kEdge_m,    -kEdge_m,    1e300,      kNan,
                                         kInfinity, -kInfinity, kEdge_m - 1, 1 - kEdge_m};
  std::mt19937_64 random(2);
  std::uniform_real_distribution<double> coordinate_m(-100, 100);
  std::vector<Eigen::Vector2d> points_m(PointBlock::kSize);
  for (const PointKernel& kernel : PointKernels()) {
    SCOPED_TRACE(kernel.name);
    for (int repetition = 0; repetition < 200; ++repetition) {
      const auto any = [&] {
        return repetition % 2 == 0 && random() % 4 == 0 ? special_m[random() % special_m.size()]
                                                        : coordinate_m(random);
      };
      for (Eigen::Vector2d& point_m : points_m) {
        const double x_m = any();
        point_m = {x_m, any()};
      }
      PointBlock block;
      block.count = PointBlock::kSize;
      const bool all_on_map = kernel.locate(points_m.data(), kKnot, block);
      bool expected_on_map = true;
      for (int n = 0; n < PointBlock::kSize; ++n) {
        const KnotPosition off_map;
        const auto x = LocateKnot(points_m[n].x(), kKnot);
        const auto y = LocateKnot(points_m[n].y(), kKnot);
        expected_on_map = expected_on_map && x && y;
        const int32_t i = x.value_or(off_map).index - 1;
        const int32_t j = y.value_or(off_map).index - 1;
        ASSERT_EQ(std::bit_cast<TileKey>(block.keys[n]), TileOf(i, j)) << points_m[n].transpose();
        ASSERT_EQ(block.indices[n], IndexInTile(i, j));
        ASSERT_EQ(block.is_crossing[n], TileOf(i, j) == TileOf(i + 3, j + 3) ? 0 : -1);
        ASSERT_EQ(block.t_x[n], x.value_or(off_map).t);
        ASSERT_EQ(block.t_y[n], y.value_or(off_map).t);
      }
      ASSERT_EQ(all_on_map, expected_on_map);
    }
  }
}

}  // namespace splinemap::point_kernel_test
