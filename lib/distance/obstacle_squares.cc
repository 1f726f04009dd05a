#include "lib/distance/obstacle_squares.h"

#include <bit>
#include <cstring>

#include "lib/query/obstacle_search.h"

namespace splinemap {

namespace {

constexpr int kPerKnot = ObstacleSquares::kPerKnot;

typedef int32_t Integers4 __attribute__((vector_size(16)));

// Bounds of a cell.
struct CellRange {
  // 36 times the least and the greatest point of its Bezier net.
  int32_t least;
  int32_t greatest;
  // 6 times by how much the surface bends down along both axes, second derivatives by knots.
  int32_t bend;
};

int32_t LeastOf(const Integers4& v) { return std::min({v[0], v[1], v[2], v[3]}); }
int32_t GreatestOf(const Integers4& v) { return std::max({v[0], v[1], v[2], v[3]}); }

// The most by which what has these control points along an axis bends down: its second derivative
// lies between their second differences.
int32_t BendOf(const std::array<Integers4, 4>& c) {
  const Integers4 a = 2 * c[1] - c[0] - c[2];
  const Integers4 b = 2 * c[2] - c[1] - c[3];
  return std::max(GreatestOf(a > b ? a : b), 0);
}

// 6 times a Bezier net of what has these control points along an axis.
std::array<Integers4, 4> SixfoldNet(const std::array<Integers4, 4>& c) {
  return {c[0] + 4 * c[1] + c[2], 4 * c[1] + 2 * c[2], 2 * c[1] + 4 * c[2], c[1] + 4 * c[2] + c[3]};
}

CellRange RangeOf(const CellPatch& patch) {
  const ControlPoint* c = patch.control_points.data();
  std::array<Integers4, 4> rows;
  for (int k = 0; k < 4; ++k) {
    rows[k] = Integers4{c[4 * k], c[4 * k + 1], c[4 * k + 2], c[4 * k + 3]};
  }
  const int32_t bend_y = BendOf(rows);
  rows = SixfoldNet(rows);
  const Integers4 low01 = __builtin_shufflevector(rows[0], rows[1], 0, 4, 1, 5);
  const Integers4 high01 = __builtin_shufflevector(rows[0], rows[1], 2, 6, 3, 7);
  const Integers4 low23 = __builtin_shufflevector(rows[2], rows[3], 0, 4, 1, 5);
  const Integers4 high23 = __builtin_shufflevector(rows[2], rows[3], 2, 6, 3, 7);
  const std::array<Integers4, 4> columns{__builtin_shufflevector(low01, low23, 0, 1, 4, 5),
                                         __builtin_shufflevector(low01, low23, 2, 3, 6, 7),
                                         __builtin_shufflevector(high01, high23, 0, 1, 4, 5),
                                         __builtin_shufflevector(high01, high23, 2, 3, 6, 7)};
  const std::array<Integers4, 4> net = SixfoldNet(columns);
  Integers4 least = net[0];
  Integers4 greatest = net[0];
  for (const Integers4& values : net) {
    least = values < least ? values : least;
    greatest = values > greatest ? values : greatest;
  }
  return {LeastOf(least), GreatestOf(greatest), 6 * bend_y + BendOf(columns)};
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

// Of a row of squares, those that have one of these corners below or above.
uint32_t WithCorner(uint32_t below, uint32_t above) {
  const uint32_t either = below | above;
  return (either | either >> 1) & 0xF;
}

// Below the threshold everywhere, by the plane above it, which the search uses, too.
bool IsBelow(const BezierNet& net, double threshold) {
  const BezierNet::Plane plane = net.Above();
  return plane.at_corner + std::max(plane.slope_x, 0.0) + std::max(plane.slope_y, 0.0) < threshold;
}

}  // namespace

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
    for (uint32_t rest = cells[y]; rest != 0; rest &= rest - 1) {
      const int x = std::countr_zero(rest);
      told |= ObstacleSquares::Row{0xF} << (kPerKnot * x);
      const CellPatch patch = control_points.At(x, y);
      const uint32_t of_cell = OfCell(patch);
      for (int row = 0; row < kPerKnot && of_cell != 0; ++row) {
        is_set[row] |= ObstacleSquares::Row{of_cell >> (4 * row) & 0xF} << (kPerKnot * x);
      }
    }
    for (int row = 0; row < kPerKnot; ++row) {
      ObstacleSquares::Row& bits = squares.rows[kPerKnot * y + row];
      bits = (bits & ~told) | is_set[row];
    }
  }
}

uint32_t ObstacleRasterizer::OfCell(const CellPatch& patch) const {
  typedef ControlPoint Shorts8 __attribute__((vector_size(16)));
  Shorts8 low;
  Shorts8 high;
  static_assert(sizeof(low) + sizeof(high) == sizeof(patch.control_points));
  std::memcpy(&low, &patch.control_points[0], sizeof(low));
  std::memcpy(&high, &patch.control_points[8], sizeof(high));
  Shorts8 least = low < high ? low : high;
  Shorts8 greatest = low > high ? low : high;
  const auto halve = [&](const Shorts8& other_least, const Shorts8& other_greatest) {
    least = least < other_least ? least : other_least;
    greatest = greatest > other_greatest ? greatest : other_greatest;
  };
  halve(__builtin_shufflevector(least, least, 4, 5, 6, 7, 0, 1, 2, 3),
        __builtin_shufflevector(greatest, greatest, 4, 5, 6, 7, 0, 1, 2, 3));
  halve(__builtin_shufflevector(least, least, 2, 3, 0, 1, 6, 7, 4, 5),
        __builtin_shufflevector(greatest, greatest, 2, 3, 0, 1, 6, 7, 4, 5));
  halve(__builtin_shufflevector(least, least, 1, 0, 3, 2, 5, 4, 7, 6),
        __builtin_shufflevector(greatest, greatest, 1, 0, 3, 2, 5, 4, 7, 6));
  // Where none is above 0, what is known is below it, by the share of the nearest.
  const double upper = threshold_ < 0 ? patch.bounds().upper : greatest[0] > 0 ? greatest[0] : -1;
  uint32_t squares = 0;
  if (least[0] >= threshold_) {
    squares = 0xFFFF;
  } else if (upper >= threshold_) {
    squares = OnSurface(patch);
  }
  if (patch.AllKnown()) return squares;
  for (int quarter = 0; quarter < 4; ++quarter) {
    const uint32_t of_quarter = uint32_t{0x33} << (2 * (quarter % 2) + 8 * (quarter / 2));
    if (patch.IsKnown(quarter % 2, quarter / 2)) continue;
    squares &= ~of_quarter;
    if (unknown_ == UnknownPolicy::kBlocked) squares |= of_quarter;
  }
  return squares;
}

uint32_t ObstacleRasterizer::OnSurface(const CellPatch& patch) const {
  const CellRange range = RangeOf(patch);
  if (range.greatest < 36 * threshold_) return 0;
  if (range.least >= 36 * threshold_) return 0xFFFF;
  const double threshold = kNetUnits * threshold_;
  const auto corners = PointsOfNets<kPerKnot + 1>(patch, 0, 0, 3);
  // The net of a square of side h is not above its corners by more than a sixth of h^2 times what
  // the surface bends down.
  const double low_threshold = threshold - kNetUnits / (6 * 6 * kPerKnot * kPerKnot) * range.bend;
  std::array<uint32_t, kPerKnot + 1> is_occupied{};
  std::array<uint32_t, kPerKnot + 1> is_high{};
  for (int y = 0; y <= kPerKnot; ++y) {
    for (int x = 0; x <= kPerKnot; ++x) {
      is_occupied[y] |= uint32_t{corners[y][x] >= threshold} << x;
      is_high[y] |= uint32_t{corners[y][x] >= low_threshold} << x;
    }
  }
  uint32_t squares = 0;
  for (int y = 0; y < kPerKnot; ++y) {
    uint32_t row = WithCorner(is_occupied[y], is_occupied[y + 1]);
    for (uint32_t rest = WithCorner(is_high[y], is_high[y + 1]) & ~row; rest != 0;
         rest &= rest - 1) {
      const int x = std::countr_zero(rest);
      row |= uint32_t{HasOccupied({PointsOfNets<4>(patch, 3 * x, 3 * y, 1)}, 0.25)} << x;
    }
    squares |= row << (kPerKnot * y);
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
