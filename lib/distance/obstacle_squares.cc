#include "lib/distance/obstacle_squares.h"

#include <bit>
#include <cstring>
#include <limits>

#include "lib/distance/vectors.h"
#include "lib/query/obstacle_search.h"

namespace splinemap {

namespace {

constexpr int kPerKnot = ObstacleSquares::kPerKnot;

typedef double Doubles4 __attribute__((vector_size(32)));
typedef int64_t Longs4 __attribute__((vector_size(32)));

// Bounds of eight cells in a row.
constexpr int kCells = 8;
struct CellRanges {
  // 36 times the least and the greatest point of its Bezier net.
  Integers8 least;
  Integers8 greatest;
  // 6 times by how much the surface bends down along both axes, second derivatives by knots.
  Integers8 bend;
};

// The most by which what has these control points along an axis bends down: its second derivative
// lies between their second differences.
SPLINEMAP_INLINE void AddBend(const Integers8 (&c)[4], Integers8& bend) {
  const Integers8 a = 2 * c[1] - c[0] - c[2];
  const Integers8 b = 2 * c[2] - c[1] - c[3];
  bend = bend > a ? bend : a;
  bend = bend > b ? bend : b;
}

// 6 times a Bezier net of what has these control points along an axis.
SPLINEMAP_INLINE void SetSixfoldNet(const Integers8 (&c)[4], Integers8 (&net)[4]) {
  net[0] = c[0] + 4 * c[1] + c[2];
  net[1] = 4 * c[1] + 2 * c[2];
  net[2] = 2 * c[1] + 4 * c[2];
  net[3] = c[1] + 4 * c[2] + c[3];
}

// `first`: the control point at the lower left of the first cell; rows are `stride` apart.
SPLINEMAP_INLINE void SetRanges(const ControlPoint* first, int stride, CellRanges& ranges) {
  typedef ControlPoint Shorts8 __attribute__((vector_size(16)));
  Integers8 along_y[4][4];  // by column
  Integers8 bend_y{};
  for (int x = 0; x < 4; ++x) {
    Integers8 column[4];
    for (int y = 0; y < 4; ++y) {
      Shorts8 points;
      std::memcpy(&points, first + stride * y + x, sizeof(points));
      column[y] = __builtin_convertvector(points, Integers8);
    }
    AddBend(column, bend_y);
    SetSixfoldNet(column, along_y[x]);
  }
  Integers8 bend_x{};
  ranges.least = Integers8{} + std::numeric_limits<int32_t>::max();
  ranges.greatest = Integers8{} + std::numeric_limits<int32_t>::min();
  for (int y = 0; y < 4; ++y) {
    const Integers8 row[4] = {along_y[0][y], along_y[1][y], along_y[2][y], along_y[3][y]};
    Integers8 net[4];
    AddBend(row, bend_x);
    SetSixfoldNet(row, net);
    for (const Integers8& values : net) {
      ranges.least = values < ranges.least ? values : ranges.least;
      ranges.greatest = values > ranges.greatest ? values : ranges.greatest;
    }
  }
  ranges.bend = 6 * bend_y + bend_x;
}

// The surface of a cell as a Bezier net of each of its squares, of which those beside each other
// share a side: 384 times how much of each of four control points there is in each point of such a
// net, along an axis. With 384^2 times a control point as its unit all is exact.
constexpr double kNetUnits = 384 * 384;
constexpr double kWeights[4][3 * kPerKnot + 1] = {
    {64, 48, 36, 27, 18, 12, 8, 4, 2, 1, 0, 0, 0},
    {256, 256, 248, 235, 222, 204, 184, 164, 142, 121, 100, 80, 64},
    {64, 80, 100, 121, 142, 164, 184, 204, 222, 235, 248, 256, 256},
    {0, 0, 0, 1, 2, 4, 8, 12, 18, 27, 36, 48, 64}};

// Of `count` points of the nets each way, so many apart; the first is (x0, y0).
template <int count>
std::array<std::array<double, count>, count> PointsOfNets(const CellPatch& patch, int x0, int y0,
                                                          int apart) {
  std::array<std::array<double, 4>, count> columns;
  for (int x = 0; x < count; ++x) {
    for (int row = 0; row < 4; ++row) {
      const ControlPoint* c = &patch.control_points[4 * row];
      const int at = x0 + apart * x;
      columns[x][row] = kWeights[0][at] * c[0] + kWeights[1][at] * c[1] + kWeights[2][at] * c[2] +
                        kWeights[3][at] * c[3];
    }
  }
  std::array<std::array<double, count>, count> points;
  for (int y = 0; y < count; ++y) {
    for (int x = 0; x < count; ++x) {
      const int at = y0 + apart * y;
      points[y][x] = kWeights[0][at] * columns[x][0] + kWeights[1][at] * columns[x][1] +
                     kWeights[2][at] * columns[x][2] + kWeights[3][at] * columns[x][3];
    }
  }
  return points;
}

// Squares of a cell, of 4 rows of 4, that have a corner at a threshold or above.
struct SquaresWithCorner {
  uint32_t high;
  uint32_t higher;
};

// Above both thresholds.
SPLINEMAP_INLINE SquaresWithCorner CornersAbove(const CellPatch& patch, double high,
                                                double higher) {
  Doubles4 rows[4];
  for (int y = 0; y < 4; ++y) {
    const ControlPoint* c = &patch.control_points[4 * y];
    rows[y] = Doubles4{static_cast<double>(c[0]), static_cast<double>(c[1]),
                       static_cast<double>(c[2]), static_cast<double>(c[3])};
  }
  // Of each row of corners, what is greater of those on the left and on the right of a square.
  Doubles4 greater[kPerKnot + 1];
  for (int y = 0; y <= kPerKnot; ++y) {
    const Doubles4 at = kWeights[0][3 * y] * rows[0] + kWeights[1][3 * y] * rows[1] +
                        kWeights[2][3 * y] * rows[2] + kWeights[3][3 * y] * rows[3];
    Doubles4 left{};
    Doubles4 right{};
    for (int k = 0; k < 4; ++k) {
      const double* w = kWeights[k];
      left += at[k] * Doubles4{w[0], w[3], w[6], w[9]};
      right += at[k] * Doubles4{w[3], w[6], w[9], w[12]};
    }
    greater[y] = left > right ? left : right;
  }
  Longs4 is_high{};
  Longs4 is_higher{};
  for (int y = 0; y < kPerKnot; ++y) {
    const Doubles4 greatest = greater[y] > greater[y + 1] ? greater[y] : greater[y + 1];
    const Longs4 bits = Longs4{1, 2, 4, 8} << (4 * y);
    is_high |= (greatest >= high) & bits;
    is_higher |= (greatest >= higher) & bits;
  }
  return {static_cast<uint32_t>(is_high[0] | is_high[1] | is_high[2] | is_high[3]),
          static_cast<uint32_t>(is_higher[0] | is_higher[1] | is_higher[2] | is_higher[3])};
}

#ifdef __x86_64__
__attribute__((target("avx2"))) void SetRangesByAvx2(const ControlPoint* first, int stride,
                                                     CellRanges& ranges) {
  SetRanges(first, stride, ranges);
}

__attribute__((target("avx2"))) SquaresWithCorner CornersAboveByAvx2(const CellPatch& patch,
                                                                     double high, double higher) {
  return CornersAbove(patch, high, higher);
}
#endif

// Below the threshold everywhere, by the plane above it, which the search uses, too.
bool IsBelow(const BezierNet& net, double threshold) {
  const BezierNet::Plane plane = net.Above();
  return plane.at_corner + std::max(plane.slope_x, 0.0) + std::max(plane.slope_y, 0.0) < threshold;
}

void FindRanges(const ControlPoint* first, CellRanges& ranges) {
  constexpr int kStride = ControlPointsAround::kSide;
#ifdef __x86_64__
  if (has_avx2) {
    SetRangesByAvx2(first, kStride, ranges);
    return;
  }
#endif
  SetRanges(first, kStride, ranges);
}

SquaresWithCorner SquaresWithCornerAbove(const CellPatch& patch, double high, double higher) {
#ifdef __x86_64__
  if (has_avx2) return CornersAboveByAvx2(patch, high, higher);
#endif
  return CornersAbove(patch, high, higher);
}

// All squares of these of eight cells.
uint32_t SquaresOfCells(uint32_t cells) {
  cells = (cells | cells << 12) & 0x000F000F;
  cells = (cells | cells << 6) & 0x03030303;
  cells = (cells | cells << 3) & 0x11111111;
  return cells * 0xF;
}

}  // namespace

// Of one of these cells.
struct ObstacleRasterizer::CellRange {
  int32_t least;
  int32_t greatest;
  int32_t bend;
};

ControlPointsAround::ControlPointsAround(const TileTree& tiles, TileKey key) {
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const std::shared_ptr<const Tile> tile = FindTile(tiles, {key.tx + dx, key.ty + dy});
      if (tile == nullptr) continue;
      const int x0 = std::max(Tile::kSide * dx, -1);
      const int x1 = std::min(Tile::kSide * (dx + 1), kSide - 1);
      const int y0 = std::max(Tile::kSide * dy, -1);
      const int y1 = std::min(Tile::kSide * (dy + 1), kSide - 1);
      for (int y = y0; y < y1; ++y) {
        std::copy_n(&tile->control_points[IndexInTile(x0, y)], x1 - x0, &rows_[y + 1][x0 + 1]);
      }
    }
  }
}

CellMask ChangedPoints(const Tile& before, const Tile& after) {
  CellMask changed{};
  for (int y = 0; y < Tile::kSide; ++y) {
    const ControlPoint* a = &before.control_points[IndexInTile(0, y)];
    const ControlPoint* b = &after.control_points[IndexInTile(0, y)];
    if (std::memcmp(a, b, Tile::kSide * sizeof(ControlPoint)) == 0) continue;
    for (int x = 0; x < Tile::kSide; ++x) changed[y] |= uint32_t{a[x] != b[x]} << x;
  }
  return changed;
}

CellMask ChangedCells(TileKey key, absl::FunctionRef<const CellMask&(TileKey)> changed) {
  // Bit x of row y: a control point that decides cell x at y - 1, of the tile.
  constexpr int kSide = Tile::kSide + 3;
  std::array<uint32_t, kSide> rows;
  for (int dy = -1; dy <= 1; ++dy) {
    const CellMask& left = changed({key.tx - 1, key.ty + dy});
    const CellMask& middle = changed({key.tx, key.ty + dy});
    const CellMask& right = changed({key.tx + 1, key.ty + dy});
    const int y0 = Tile::kSide * dy;
    for (int y = std::max(y0, -1); y < std::min(y0 + Tile::kSide, kSide - 1); ++y) {
      uint64_t row = uint64_t{left[y - y0]} >> (Tile::kSide - 1) | uint64_t{middle[y - y0]} << 1 |
                     uint64_t{right[y - y0]} << (Tile::kSide + 1);
      row |= row >> 1;
      row |= row >> 2;
      rows[y + 1] = static_cast<uint32_t>(row);
    }
  }
  CellMask cells;
  for (int y = 0; y < Tile::kSide; ++y)
    cells[y] = rows[y] | rows[y + 1] | rows[y + 2] | rows[y + 3];
  return cells;
}

void ObstacleRasterizer::Update(const ControlPointsAround& control_points, const CellMask& cells,
                                ObstacleSquares& squares) const {
  for (int y = 0; y < Tile::kSide; ++y) {
    if (cells[y] == 0) continue;
    ObstacleSquares::Row told = 0;
    std::array<ObstacleSquares::Row, kPerKnot> is_set{};
    for (int x0 = 0; x0 < Tile::kSide; x0 += kCells) {
      uint32_t rest = cells[y] >> x0 & 0xFF;
      if (rest == 0) continue;
      told |= ObstacleSquares::Row{SquaresOfCells(rest)} << (kPerKnot * x0);
      CellRanges ranges;
      FindRanges(control_points.From(x0, y), ranges);
      for (; rest != 0; rest &= rest - 1) {
        const int k = std::countr_zero(rest);
        const bool is_low = ranges.greatest[k] < 36 * threshold_;
        if (is_low && unknown_ == UnknownPolicy::kFree) continue;
        const uint32_t of_cell = OfCell(control_points.At(x0 + k, y),
                                        {ranges.least[k], ranges.greatest[k], ranges.bend[k]});
        for (int row = 0; row < kPerKnot && of_cell != 0; ++row) {
          is_set[row] |= ObstacleSquares::Row{of_cell >> (4 * row) & 0xF} << (kPerKnot * (x0 + k));
        }
      }
    }
    for (int row = 0; row < kPerKnot; ++row) {
      ObstacleSquares::Row& bits = squares.rows[kPerKnot * y + row];
      bits = (bits & ~told) | is_set[row];
    }
  }
}

uint32_t ObstacleRasterizer::OfCell(const CellPatch& patch, const CellRange& range) const {
  uint32_t squares = OnSurface(patch, range);
  if (patch.AllKnown()) return squares;
  for (int quarter = 0; quarter < 4; ++quarter) {
    const uint32_t of_quarter = uint32_t{0x33} << (2 * (quarter % 2) + 8 * (quarter / 2));
    if (patch.IsKnown(quarter % 2, quarter / 2)) continue;
    squares &= ~of_quarter;
    if (unknown_ == UnknownPolicy::kBlocked) squares |= of_quarter;
  }
  return squares;
}

uint32_t ObstacleRasterizer::OnSurface(const CellPatch& patch, const CellRange& range) const {
  if (range.greatest < 36 * threshold_) return 0;
  // Where none is above 0, what is known is below it, by the share of the nearest.
  if (threshold_ < 0 || range.greatest <= 0) {
    const auto& c = patch.control_points;
    if (*std::min_element(c.begin(), c.end()) >= threshold_) return 0xFFFF;
    if (threshold_ < 0 && patch.bounds().upper < threshold_) return 0;
    if (threshold_ >= 0 && *std::max_element(c.begin(), c.end()) <= 0) return 0;
  }
  if (range.least >= 36 * threshold_) return 0xFFFF;
  const double threshold = kNetUnits * threshold_;
  // The net of a square of side h is not above its corners by more than a sixth of h^2 times what
  // the surface bends down.
  const double low_threshold = threshold - kNetUnits / (6 * 6 * kPerKnot * kPerKnot) * range.bend;
  const SquaresWithCorner corners = SquaresWithCornerAbove(patch, low_threshold, threshold);
  uint32_t squares = corners.higher;
  for (uint32_t rest = corners.high & ~squares; rest != 0; rest &= rest - 1) {
    const int x = std::countr_zero(rest) % kPerKnot;
    const int y = std::countr_zero(rest) / kPerKnot;
    if (HasOccupied({PointsOfNets<4>(patch, 3 * x, 3 * y, 1)}, 0.25)) squares |= rest & -rest;
  }
  return squares;
}

bool ObstacleRasterizer::HasOccupied(const BezierNet& net, double side) const {
  const double threshold = kNetUnits * threshold_;
  const double most_at_corners =
      std::max({net.rows[0][0], net.rows[0][3], net.rows[3][0], net.rows[3][3]});
  if (most_at_corners >= threshold) return true;
  if (net.Greatest() < threshold || IsBelow(net, threshold)) return false;
  if (side <= ObstacleSearch::kFinestSide) return true;
  for (int k = 0; k < 4; ++k) {
    if (HasOccupied(net.Quarter(k % 2 == 1, k / 2 == 1), side / 2)) return true;
  }
  return false;
}

}  // namespace splinemap
