#pragma once

#include <cstdint>
#include <vector>

#include "splinemap/tile.h"

namespace splinemap {

// In eighths of a knot interval, from the corner of a tile.
struct Site {
  static constexpr int kUnits = 8;

  int16_t x;
  int16_t y;
  bool operator==(const Site&) const = default;
};

// From a vertex to a site.
struct SiteOffset {
  static constexpr int16_t kNone = INT16_MIN;  // nothing is near

  int16_t x = kNone;
  int16_t y = kNone;
  bool operator==(const SiteOffset&) const = default;
};

// To no site: the vertex had one that went, and what is nearest now is to be found.
inline constexpr SiteOffset kLost{0, 0};

// 8 x 8 vertices of the knot grid, (x0, y0) the first of them, counted from the corner of a tile.
struct VertexBlock {
  static constexpr int kSide = 8;
  static constexpr int kSize = kSide * kSide;

  int x0;
  int y0;
};

// A box of vertices, in the units of sites.
struct VertexBox {
  Site low;
  Site high;
};

// What a block's vertices have, x runs fastest.
struct NearestOfBlock {
  static constexpr int32_t kBias = 1 << 15;

  int32_t reach_squared;
  uint64_t lost;  // a bit for each vertex that had lost its site
  // Offsets as the numbers of their bits, but for the highest of x (kBias): so they are less by y,
  // then by x.
  alignas(32) int32_t ways[VertexBlock::kSize];
  // Where nothing is near one more than the reach; negative where a vertex keeps what it has.
  alignas(32) int32_t squared[VertexBlock::kSize];
};

// Bounds of eight knot cells in a row.
struct CellRanges {
  static constexpr int kCells = 8;

  // 36 times the least and the greatest point of its Bezier net.
  alignas(32) int32_t least[kCells];
  alignas(32) int32_t greatest[kCells];
  // 6 times by how much the surface bends down along both axes, second derivatives by knots.
  alignas(32) int32_t bend[kCells];
};

// The surface of a cell as a Bezier net of each of its squares, of which those beside each other
// share a side: 384 times how much of each of four control points there is in each point of such a
// net, along an axis. With 384^2 times a control point as its unit all is exact.
inline constexpr double kNetUnits = 384 * 384;
inline constexpr double kNetWeights[4][13] = {
    {64, 48, 36, 27, 18, 12, 8, 4, 2, 1, 0, 0, 0},
    {256, 256, 248, 235, 222, 204, 184, 164, 142, 121, 100, 80, 64},
    {64, 80, 100, 121, 142, 164, 184, 204, 222, 235, 248, 256, 256},
    {0, 0, 0, 1, 2, 4, 8, 12, 18, 27, 36, 48, 64}};

// Squares of a cell, of 4 rows of 4, that have a corner at a threshold or above.
struct SquaresWithCorner {
  uint32_t high;
  uint32_t higher;
};

// The inner loops of NearestSites and ObstacleRasterizer, compiled for one instruction set. All of
// them give the same bytes. Offsets of vertices are in rows as far apart as those of a tile, blocks
// and sites from the corner of the same tile.
struct DistanceKernel {
  const char* name;  // "plain", "avx2", "avx512"

  // Reads what a block's vertices have; only of those that lost theirs, if the others keep it.
  void (*read)(const SiteOffset* offsets, bool only_lost, NearestOfBlock& nearest);
  // Whether a vertex takes one of the sites.
  bool (*add)(const Site* sites, int count, const VertexBlock& block, NearestOfBlock& nearest);
  int32_t (*longest_squared)(const NearestOfBlock& nearest);
  // Here without gaps between rows.
  void (*write)(const NearestOfBlock& nearest, SiteOffset* offsets);
  // Whether a vertex has one of the sites: it loses that.
  bool (*take_away)(const Site* sites, int count, const VertexBlock& block,
                    NearestOfBlock& nearest);
  // Of the blocks of a tile, a bit for each that is no farther from a box than its limit, squared.
  // Of a block what lies from `first` to `last` counts, from its corner, in the units of sites.
  uint32_t (*blocks_near)(const VertexBox& box, int first, int last, const int32_t* limits);
  // Copies those that SomeSites::NotHidden() keeps; says how many. It may write kSpareSites more
  // than there are.
  static constexpr int kSpareSites = 7;
  int (*keep_not_hidden)(const Site* sites, int count, const VertexBox& box, const Site& other,
                         Site* kept);

  // Of the eight cells from the one with this first control point; rows are `stride` apart.
  void (*find_ranges)(const ControlPoint* first, int stride, CellRanges& ranges);
  // Above both thresholds, in net units. `patch` as that of a CellPatch.
  SquaresWithCorner (*find_corners)(const ControlPoint* patch, double high, double higher);
  // The net of square (x, y) of the cell, 4 rows of 4 in net units.
  void (*find_net)(const ControlPoint* patch, int x, int y, double* net);
};

// Those that this processor can run, the plain one first, the fastest last.
const std::vector<DistanceKernel>& DistanceKernels();
inline const DistanceKernel& FastestDistanceKernel() {
  static const DistanceKernel& fastest = DistanceKernels().back();
  return fastest;
}

}  // namespace splinemap
