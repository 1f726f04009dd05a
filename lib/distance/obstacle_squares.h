#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "absl/functional/function_ref.h"
#include "lib/query/bezier_net.h"
#include "lib/query/cell_patch.h"
#include "lib/query/surface_bounds.h"
#include "splinemap/queries.h"

namespace splinemap {

// The squares of a tile, of 1/4 knot interval, with a point that is occupied, or unknown where that
// stops; as ObstacleSearch finds them, to 1/32 knot interval. Square (x, y) is
// [x, x + 1] x [y, y + 1] / 4 from the tile's corner: bit x % 32 of word x / 32 of row y.
struct ObstacleSquares {
  static constexpr int kPerKnot = 4;
  static constexpr int kSide = Tile::kSide * kPerKnot;

  using Row = std::array<uint32_t, kSide / 32>;

  std::array<Row, kSide> rows{};

  bool operator==(const ObstacleSquares& other) const {
    return std::memcmp(rows.data(), other.rows.data(), sizeof rows) == 0;
  }
  bool IsSet(int x, int y) const { return (rows[y][x / 32] >> (x % 32) & 1) != 0; }
  bool IsEmpty() const { return *this == ObstacleSquares(); }
  static ObstacleSquares All() {
    ObstacleSquares squares;
    for (Row& row : squares.rows) row.fill(~uint32_t{0});
    return squares;
  }
};

// A bit for each knot cell of a tile, or control point, by row.
using CellMask = std::array<uint32_t, Tile::kSide>;

// The control points in which two contents of a tile differ.
CellMask ChangedPoints(const Tile& before, const Tile& after);

// The cells of a tile that are decided by one of the control points `changed`, which is called with
// the keys of the tile and those around it.
CellMask ChangedCells(TileKey key, absl::FunctionRef<const CellMask&(TileKey)> changed);

// The control points that decide the cells of a tile: from -1 to 33 of it, each way.
class ControlPointsAround {
 public:
  ControlPointsAround(const TileTree& tiles, TileKey key);

  static constexpr int kSide = Tile::kSide + 3;

  // Those of cell (x, y) and of others, in rows of kSide.
  const ControlPoint* From(int x, int y) const { return &rows_[y][x]; }

  CellPatch At(int x, int y) const {
    CellPatch patch;
    for (int row = 0; row < 4; ++row) {
      std::copy_n(&rows_[y + row][x], 4, &patch.control_points[4 * row]);
    }
    return patch;
  }

 private:
  std::array<std::array<ControlPoint, kSide>, kSide> rows_{};
};

// Finds the squares of a tile. Immutable, thread-safe.
class ObstacleRasterizer {
 public:
  // `threshold` in units of control points.
  ObstacleRasterizer(double threshold, UnknownPolicy unknown)
      : threshold_(threshold), unknown_(unknown) {}

  // Looks at these cells; the squares of others stay.
  void Update(const ControlPointsAround& control_points, const CellMask& cells,
              ObstacleSquares& squares) const;

 private:
  bool HasOccupied(const BezierNet& net, double side) const;
  struct CellRange;
  // Those that have an occupied point, of 4 rows of 4, of which the surface decides.
  uint32_t OnSurface(const CellPatch& patch, const CellRange& range) const;
  uint32_t OfCell(const CellPatch& patch, const CellRange& range) const;

  const double threshold_;
  const UnknownPolicy unknown_;
};

}  // namespace splinemap
