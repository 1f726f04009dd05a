#pragma once

#include <array>
#include <cstdint>

#include "lib/query/cell_patch.h"
#include "lib/query/queries.h"
#include "lib/query/surface_bounds.h"

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

// Of the tile that has these bounds; `threshold` in units of control points.
ObstacleSquares SquaresOf(PatchReader& patches, TileKey key, const TileBounds& bounds,
                          double threshold, Unknown unknown);

}  // namespace splinemap
