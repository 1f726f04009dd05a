#include "splinemap/tile.h"

#include <algorithm>
#include <cstring>

namespace splinemap {

TouchedPoints TouchedPointsOf(const Tile& tile) {
  TouchedPoints touched{.i0 = Tile::kSide, .j0 = Tile::kSide, .i1 = -1, .j1 = -1};
  for (int k = 0; k < Tile::kSize; ++k) {
    if (tile.control_points[k] == 0) continue;
    const auto i = static_cast<int8_t>(k % Tile::kSide);
    const auto j = static_cast<int8_t>(k / Tile::kSide);
    ++touched.points;
    touched.i0 = std::min(touched.i0, i);
    touched.j0 = std::min(touched.j0, j);
    touched.i1 = std::max(touched.i1, i);
    touched.j1 = std::max(touched.j1, j);
  }
  return touched.points == 0 ? TouchedPoints() : touched;
}

TileCells SettledCellsOf(const Tile& tile) {
  typedef uint16_t Points __attribute__((vector_size(16)));
  TileCells cells = 0;
  for (int cell = 0; cell < 64; cell += 2) {
    const ControlPoint* first = &tile.control_points[IndexInTile(4 * (cell % 8), 4 * (cell / 8))];
    Points any{};
    for (int row = 0; row < 4; ++row) {
      Points points;
      std::memcpy(&points, first + row * Tile::kSide, sizeof(points));
      any |= points + kToSettled;
    }
    uint64_t of_cell[2];
    any &= kBeyondSettled;
    std::memcpy(of_cell, &any, sizeof(of_cell));
    cells |= TileCells{of_cell[0] == 0} << cell;
    cells |= TileCells{of_cell[1] == 0} << (cell + 1);
  }
  return cells;
}

}  // namespace splinemap
