#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "splinemap/surface.h"
#include "splinemap/tile.h"

namespace splinemap {

inline constexpr double kLogOddsPerUnit = 1.0 / kUnitsPerLogOdds;

// Some points, few enough for the fastest cache. alignas: for vectors of four.
struct PointBlock {
  static constexpr int kSize = 64;
  // Of each point: the first control point of its patch, and where it lies in its knot interval.
  int32_t i[kSize];
  int32_t j[kSize];
  alignas(32) double t_x[kSize];
  alignas(32) double t_y[kSize];
  // The control points, as PointKernel takes them.
  const ControlPoint* patches[kSize];
};

// The inner loops of queries, compiled for one instruction set. All of them give the same bytes,
// which are those of LocateKnot() and EvaluatePatch(). They are given patches by their first
// control points; rows are as far apart as those of a tile.
struct PointKernel {
  const char* name;  // "plain", "avx2", "avx512"

  void (*evaluate_point)(const ControlPoint* patch, double t_x, double t_y, double knots_per_m,
                         SurfaceSample& sample);

  // The rest is about points in fours; `count` is a multiple of 4, at most PointBlock::kSize.

  // Sets all of `block` but the patches; returns whether all points are on the map. Those that are
  // not are located in knot 0.
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
