#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "splinemap/surface.h"
#include "splinemap/tile.h"

namespace splinemap {

inline constexpr double kLogOddsPerUnit = 1.0 / kUnitsPerLogOdds;

// Some points, few enough for the fastest cache. alignas: for vectors.
struct PointBlock {
  static constexpr int kSize = 64;
  int count = 0;  // a multiple of 8
  // Of each point: the tile of the first control point of its patch, a TileKey; the place of that
  // in the tile; -1 if the patch reaches other tiles, too, else 0; and where the point lies in its
  // knot interval.
  uint64_t keys[kSize];
  int32_t indices[kSize];
  int32_t is_crossing[kSize];
  alignas(64) double t_x[kSize];
  alignas(64) double t_y[kSize];
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

  // Sets all of a block of block.count points but the patches; returns whether all points are on
  // the map. Those that are not are located in knot 0.
  bool (*locate)(const Eigen::Vector2d* points_m, double knot_interval_m, PointBlock& block);
  // Meanwhile it has the patches of the next block on their way from memory; that has no more
  // points.
  void (*evaluate)(const PointBlock& block, const PointBlock& next, double knots_per_m,
                   SurfaceSample* samples);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<PointKernel>& PointKernels();
inline const PointKernel& FastestPointKernel() {
  static const PointKernel& fastest = PointKernels().back();
  return fastest;
}

}  // namespace splinemap
