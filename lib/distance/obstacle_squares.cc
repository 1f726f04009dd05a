#include "lib/distance/obstacle_squares.h"

#include <bit>
#include <cstring>

#include "lib/distance/distance_kernel.h"
#include "lib/query/obstacle_search.h"

namespace splinemap {

namespace {

constexpr int kPerKnot = ObstacleSquares::kPerKnot;

// Below the threshold everywhere, by the plane above it, which the search uses, too.
bool IsBelow(const BezierNet& net, double threshold) {
  const BezierNet::Plane plane = net.Above();
  return plane.at_corner + std::max(plane.slope_x, 0.0) + std::max(plane.slope_y, 0.0) < threshold;
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
  typedef ControlPoint ControlPoints8 __attribute__((vector_size(16)));
  typedef int8_t Bytes8 __attribute__((vector_size(8)));
  CellMask changed{};
  for (int n = 0; n < Tile::kSize; n += 8) {
    ControlPoints8 a;
    ControlPoints8 b;
    std::memcpy(&a, &before.control_points[n], sizeof a);
    std::memcpy(&b, &after.control_points[n], sizeof b);
    const auto bytes = __builtin_convertvector(a == b, Bytes8) + 1;
    // Gathers a bit of each byte in the highest one.
    const uint64_t bits = std::bit_cast<uint64_t>(bytes) * 0x0102040810204080 >> 56;
    changed[n / Tile::kSide] |= static_cast<uint32_t>(bits << n % Tile::kSide);
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
  const DistanceKernel& kernel = FastestDistanceKernel();
  for (int y = 0; y < Tile::kSide; ++y) {
    if (cells[y] == 0) continue;
    for (int x0 = 0; x0 < Tile::kSide; x0 += CellRanges::kCells) {
      uint32_t rest = cells[y] >> x0 & 0xFF;
      if (rest == 0) continue;
      const uint32_t told = SquaresOfCells(rest);
      std::array<uint32_t, kPerKnot> is_set{};
      CellRanges ranges;
      kernel.find_ranges(control_points.From(x0, y), ControlPointsAround::kSide, ranges);
      for (; rest != 0; rest &= rest - 1) {
        const int k = std::countr_zero(rest);
        const bool is_low = ranges.greatest[k] < 36 * threshold_;
        if (is_low && unknown_ == UnknownPolicy::kFree) continue;
        const uint32_t of_cell = OfCell(control_points.At(x0 + k, y),
                                        {ranges.least[k], ranges.greatest[k], ranges.bend[k]});
        for (int row = 0; row < kPerKnot; ++row) {
          is_set[row] |= (of_cell >> (4 * row) & 0xF) << (kPerKnot * k);
        }
      }
      for (int row = 0; row < kPerKnot; ++row) {
        uint32_t& word = squares.rows[kPerKnot * y + row][x0 / CellRanges::kCells];
        word = (word & ~told) | is_set[row];
      }
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
  const SquaresWithCorner corners =
      FastestDistanceKernel().find_corners(patch.control_points.data(), low_threshold, threshold);
  uint32_t squares = corners.higher;
  for (uint32_t rest = corners.high & ~squares; rest != 0; rest &= rest - 1) {
    const int x = std::countr_zero(rest) % kPerKnot;
    const int y = std::countr_zero(rest) / kPerKnot;
    BezierNet net;
    FastestDistanceKernel().find_net(patch.control_points.data(), x, y, net.rows[0].data());
    if (HasOccupied(net, 0.25)) squares |= rest & -rest;
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
