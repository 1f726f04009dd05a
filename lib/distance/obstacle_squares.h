#pragma once

#include <array>
#include <cstdint>

#include "lib/query/bezier_net.h"
#include "lib/query/cell_patch.h"
#include "lib/query/surface_bounds.h"
#include "splinemap/queries.h"

namespace splinemap {

// The squares of a tile, of 1/4 knot interval, with a point that is occupied, or unknown where that
// stops; as ObstacleSearch finds them, to 1/32 knot interval. Bit x of row y is the square
// [x, x + 1] x [y, y + 1] / 4 from the tile's corner.
struct ObstacleSquares {
  static constexpr int kPerKnot = 4;
  static constexpr int kSide = Tile::kSide * kPerKnot;

  using Row = unsigned __int128;
  static_assert(8 * sizeof(Row) == kSide);

  std::array<Row, kSide> rows{};

  bool operator==(const ObstacleSquares&) const = default;
  bool IsEmpty() const { return *this == ObstacleSquares(); }
  static ObstacleSquares All() {
    ObstacleSquares squares;
    squares.rows.fill(~Row{0});
    return squares;
  }
};

// A bit for each knot cell of a tile, by row.
using CellMask = std::array<uint32_t, Tile::kSide>;

// The cells that one of the tiles near them decides otherwise in `after` than in `before`.
CellMask ChangedCells(const TileTree& before, const TileTree& after, TileKey key);

// Finds the squares of a map. Thread-compatible; outlived by the tiles.
class ObstacleRasterizer {
 public:
  // `threshold` in units of control points.
  ObstacleRasterizer(const TileTree& tiles, double threshold, UnknownPolicy unknown)
      : threshold_(threshold), unknown_(unknown), patches_(tiles) {}

  // Looks at these cells of the tile that has the bounds; the squares of others stay.
  void Update(TileKey key, const TileBounds& bounds, const CellMask& cells,
              ObstacleSquares& squares);

 private:
  bool IsClear(const Bounds& bounds) const {
    return bounds.upper < threshold_ && (bounds.all_known || unknown_ == UnknownPolicy::kFree);
  }
  bool IsFree(const BezierNet& net) const;
  bool HasOccupied(const BezierNet& net, double side) const;
  // 2 rows of 2 bits, in a cell's 4 rows of 4.
  uint32_t OfQuarter(bool is_known, const Bounds& bounds, const BezierNet& cell, bool right,
                     bool upper) const;
  uint32_t OfCell(const CellPatch& patch) const;

  const double threshold_;
  const UnknownPolicy unknown_;
  PatchReader patches_;
};

}  // namespace splinemap
