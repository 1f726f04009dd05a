#include "lib/query/obstacle_squares.h"

#include <algorithm>
#include <bit>

#include "lib/query/bezier_net.h"
#include "lib/query/obstacle_search.h"

namespace splinemap {
namespace {

class SquareFinder {
 public:
  SquareFinder(double threshold, Unknown unknown) : threshold_(threshold), unknown_(unknown) {}

  bool IsClear(const Bounds& bounds) const {
    return bounds.upper < threshold_ && (bounds.all_known || unknown_ == Unknown::kPasses);
  }

  uint32_t CellsToLookAt(const TileBounds& bounds, int row) const {
    const uint32_t may_be_occupied = threshold_ < 0 ? ~uint32_t{0} : bounds.positive[row];
    return unknown_ == Unknown::kStops ? may_be_occupied | bounds.unknown[row] : may_be_occupied;
  }

  // Of a knot cell, 4 rows of 4 bits.
  uint32_t OfCell(const CellPatch& patch) const {
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

 private:
  uint32_t OfQuarter(bool is_known, const Bounds& bounds, const BezierNet& cell, bool right,
                     bool upper) const {
    constexpr uint32_t kAll = 0x33;  // 2 rows of 2 bits
    if (!is_known) return unknown_ == Unknown::kStops ? kAll : 0;
    if (bounds.lower >= threshold_) return kAll;
    if (bounds.upper < threshold_) return 0;
    const BezierNet net = cell.Quarter(right, upper);
    if (IsFree(net)) return 0;
    if (net.Least() >= threshold_) return kAll;
    uint32_t squares = 0;
    for (int k = 0; k < 4; ++k) {
      const bool is_set = HasOccupied(net.Quarter(k % 2 == 1, k / 2 == 1), 0.25);
      squares |= uint32_t{is_set} << (k % 2 + 4 * (k / 2));
    }
    return squares;
  }

  bool IsFree(const BezierNet& net) const {
    if (net.Greatest() < threshold_) return true;
    const BezierNet::Plane plane = net.Above();
    return plane.at_corner + std::max(plane.slope_x, 0.0) + std::max(plane.slope_y, 0.0) <
           threshold_;
  }

  bool HasOccupied(const BezierNet& net, double side) const {
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

  const double threshold_;
  const Unknown unknown_;
};

}  // namespace

ObstacleSquares SquaresOf(PatchReader& patches, TileKey key, const TileBounds& bounds,
                          double threshold, Unknown unknown) {
  constexpr int kPerKnot = ObstacleSquares::kPerKnot;
  ObstacleSquares squares;
  const SquareFinder finder(threshold, unknown);
  if (finder.IsClear(bounds.whole)) return squares;
  for (int y = 0; y < Tile::kSide; ++y) {
    uint32_t cells = finder.CellsToLookAt(bounds, y);
    for (; cells != 0; cells &= cells - 1) {
      const int x = std::countr_zero(cells);
      const uint32_t of_cell =
          finder.OfCell(patches.Read(Tile::kSide * key.tx + x, Tile::kSide * key.ty + y));
      for (int row = 0; row < kPerKnot; ++row) {
        squares.rows[kPerKnot * y + row] |= ObstacleSquares::Row{of_cell >> (4 * row) & 0xFU}
                                            << (kPerKnot * x);
      }
    }
  }
  return squares;
}

}  // namespace splinemap
