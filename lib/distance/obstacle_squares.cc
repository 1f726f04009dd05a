#include "lib/distance/obstacle_squares.h"

#include <algorithm>
#include <bit>

#include "lib/query/obstacle_search.h"

namespace splinemap {

CellMask ChangedCells(const TileTree& before, const TileTree& after, TileKey key) {
  static const StoredTile kUntouched;
  // The control points that decide the cells, from -1 to 33 of the tile: bit x + 1 of row y + 1.
  constexpr int kSide = Tile::kSide + 3;
  std::array<uint64_t, kSide> changed{};
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const TileKey neighbour{key.tx + dx, key.ty + dy};
      const StoredTile* was = before.Find(neighbour);
      const StoredTile* is = after.Find(neighbour);
      if (was == is) continue;
      if (was == nullptr) was = &kUntouched;
      if (is == nullptr) is = &kUntouched;
      const std::shared_ptr<const Tile> a = was->Get();
      const std::shared_ptr<const Tile> b = is->Get();
      const int x0 = Tile::kSide * dx;
      const int y0 = Tile::kSide * dy;
      for (int y = std::max(y0, -1); y < std::min(y0 + Tile::kSide, kSide - 1); ++y) {
        for (int x = std::max(x0, -1); x < std::min(x0 + Tile::kSide, kSide - 1); ++x) {
          const int index = IndexInTile(x, y);
          changed[y + 1] |= uint64_t{a->control_points[index] != b->control_points[index]}
                            << (x + 1);
        }
      }
    }
  }
  for (uint64_t& row : changed) {
    row |= row >> 1;
    row |= row >> 2;
  }
  CellMask cells;
  for (int y = 0; y < Tile::kSide; ++y) {
    cells[y] = static_cast<uint32_t>(changed[y] | changed[y + 1] | changed[y + 2] | changed[y + 3]);
  }
  return cells;
}

void ObstacleRasterizer::Update(TileKey key, const TileBounds& bounds, const CellMask& cells,
                                ObstacleSquares& squares) {
  constexpr int kPerKnot = ObstacleSquares::kPerKnot;
  const bool is_clear = IsClear(bounds.whole);
  for (int y = 0; y < Tile::kSide; ++y) {
    uint32_t not_clear = threshold_ < 0 ? ~uint32_t{0} : bounds.positive[y];
    if (unknown_ == UnknownPolicy::kBlocked) not_clear |= bounds.unknown[y];
    if (is_clear) not_clear = 0;
    for (uint32_t rest = cells[y]; rest != 0; rest &= rest - 1) {
      const int x = std::countr_zero(rest);
      uint32_t of_cell = 0;
      if ((not_clear >> x & 1) != 0) {
        of_cell = OfCell(patches_.Read(Tile::kSide * key.tx + x, Tile::kSide * key.ty + y));
      }
      for (int row = 0; row < kPerKnot; ++row) {
        ObstacleSquares::Row& bits = squares.rows[kPerKnot * y + row];
        bits &= ~(ObstacleSquares::Row{0xF} << (kPerKnot * x));
        bits |= ObstacleSquares::Row{of_cell >> (4 * row) & 0xF} << (kPerKnot * x);
      }
    }
  }
}

uint32_t ObstacleRasterizer::OfCell(const CellPatch& patch) const {
  const Bounds bounds = patch.bounds();
  if (IsClear(bounds)) return 0;
  const bool is_on_the_surface = bounds.lower < threshold_ && bounds.upper >= threshold_;
  const BezierNet net = is_on_the_surface ? BezierNet::OfCell(patch) : BezierNet();
  uint32_t squares = 0;
  for (int quarter = 0; quarter < 4; ++quarter) {
    const int x = quarter % 2;
    const int y = quarter / 2;
    squares |= OfQuarter(patch.IsKnown(x, y), bounds, net, x == 1, y == 1) << (2 * x + 8 * y);
  }
  return squares;
}

uint32_t ObstacleRasterizer::OfQuarter(bool is_known, const Bounds& bounds, const BezierNet& cell,
                                       bool right, bool upper) const {
  constexpr uint32_t kAll = 0x33;
  if (!is_known) return unknown_ == UnknownPolicy::kBlocked ? kAll : 0;
  if (bounds.lower >= threshold_) return kAll;
  if (bounds.upper < threshold_) return 0;
  const BezierNet net = cell.Quarter(right, upper);
  if (net.Greatest() < threshold_) return 0;
  if (net.Least() >= threshold_) return kAll;
  uint32_t squares = 0;
  for (int k = 0; k < 4; ++k) {
    const bool is_set = HasOccupied(net.Quarter(k % 2 == 1, k / 2 == 1), 0.25);
    squares |= uint32_t{is_set} << (k % 2 + 4 * (k / 2));
  }
  return squares;
}

// Below the threshold everywhere, by the net or by the plane above it, which the search uses, too.
bool ObstacleRasterizer::IsFree(const BezierNet& net) const {
  if (net.Greatest() < threshold_) return true;
  const BezierNet::Plane plane = net.Above();
  return plane.at_corner + std::max(plane.slope_x, 0.0) + std::max(plane.slope_y, 0.0) < threshold_;
}

bool ObstacleRasterizer::HasOccupied(const BezierNet& net, double side) const {
  const double most_at_corners =
      std::max({net.rows[0][0], net.rows[0][3], net.rows[3][0], net.rows[3][3]});
  if (most_at_corners >= threshold_) return true;
  if (IsFree(net)) return false;
  if (side <= ObstacleSearch::kFinestSide) return true;
  for (int k = 0; k < 4; ++k) {
    if (HasOccupied(net.Quarter(k % 2 == 1, k / 2 == 1), side / 2)) return true;
  }
  return false;
}

}  // namespace splinemap
