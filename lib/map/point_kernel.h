#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cstdint>
#include <vector>

#include "splinemap/surface.h"
#include "splinemap/tile.h"

namespace splinemap {

// Four control points of a row, the first in the low 16 bits, and the rows of a patch.
using RowWord = uint64_t;
using PatchRows = std::array<RowWord, 4>;
static_assert(std::endian::native == std::endian::little);

inline constexpr double kLogOddsPerUnit = 1.0 / kUnitsPerLogOdds;

// Some points, few enough for the fastest cache. alignas: for vectors of four.
struct PointBlock {
  static constexpr int kSize = 64;
  // Of each point: the first control point of its patch, and where it lies in its knot interval.
  std::array<int32_t, kSize> i;
  std::array<int32_t, kSize> j;
  alignas(32) std::array<double, kSize> t_x;
  alignas(32) std::array<double, kSize> t_y;
  // By row of the patch, and then by point.
  alignas(32) std::array<std::array<RowWord, kSize>, 4> rows;
};

// The inner loops of queries, compiled for one instruction set. All of them give the same bytes,
// which are those of LocateKnot() and EvaluatePatch().
struct PointKernel {
  const char* name;  // "plain", "avx2", "avx512"

  void (*evaluate_point)(const PatchRows& rows, double t_x, double t_y, double knots_per_m,
                         SurfaceSample& sample);

  // The rest is about points in fours; `count` is a multiple of 4, at most PointBlock::kSize.

  // Sets all of `block` but the rows; returns whether all points are on the map. Those that are not
  // are located in knot 0.
  bool (*locate)(const Eigen::Vector2d* points_m, int count, double knot_interval_m,
                 PointBlock& block);
  void (*evaluate)(const PointBlock& block, int count, double knots_per_m, SurfaceSample* samples);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<PointKernel>& PointKernels();
inline const PointKernel& FastestPointKernel() {
  static const PointKernel& fastest = PointKernels().back();
  return fastest;
}

}  // namespace splinemap
