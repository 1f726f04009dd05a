#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "lib/query/surface_bounds.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The control points of a knot cell (i, j), those of i - 1 .. i + 2 and j - 1 .. j + 2, x fastest.
struct CellPatch {
  std::array<ControlPoint, 16> control_points;

  // Of the control points nearest to points of the cell: (0, 0) is (i, j), (1, 1) is (i+1, j+1).
  bool IsKnown(int x, int y) const { return control_points[4 * (y + 1) + x + 1] != 0; }
  bool AllKnown() const { return IsKnown(0, 0) && IsKnown(1, 0) && IsKnown(0, 1) && IsKnown(1, 1); }

  Bounds bounds() const {
    int greatest_touched = std::numeric_limits<ControlPoint>::min();
    int least = std::numeric_limits<ControlPoint>::max();
    bool all_touched = true;
    for (const int control_point : control_points) {
      least = std::min(least, control_point);
      all_touched = all_touched && control_point != 0;
      if (control_point != 0) greatest_touched = std::max(greatest_touched, control_point);
    }
    return BoundsOf(greatest_touched, least, all_touched, AllKnown());
  }
};

// Reads patches of one map; remembers where the last one was. Thread-compatible.
class PatchReader {
 public:
  explicit PatchReader(const TileTree& tiles) : tiles_(tiles) {}

  CellPatch Read(int32_t i, int32_t j) {
    constexpr int kLast = Tile::kSide - 4;
    const int32_t left = i - 1;
    const int32_t low = j - 1;
    const TileKey key = TileOf(left, low);
    if (!is_any_ || key != key_) Go(key);
    CellPatch patch;
    const int x = left & (Tile::kSide - 1);
    const int y = low & (Tile::kSide - 1);
    if (x <= kLast && y <= kLast) {
      for (int row = 0; row < 4; ++row) {
        std::copy_n(&square_[0]->control_points[IndexInTile(x, y + row)], 4,
                    &patch.control_points[4 * row]);
      }
      return patch;
    }
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) {
        const Tile& tile = *square_[2 * ((y + row) / Tile::kSide) + (x + column) / Tile::kSide];
        patch.control_points[4 * row + column] =
            tile.control_points[IndexInTile(x + column, y + row)];
      }
    }
    return patch;
  }

 private:
  void Go(TileKey key) {
    static constexpr Tile kUntouched;
    key_ = key;
    is_any_ = true;
    for (int k = 0; k < 4; ++k) {
      held_[k] = FindTile(tiles_, {key.tx + k % 2, key.ty + k / 2});
      square_[k] = held_[k] == nullptr ? &kUntouched : held_[k].get();
    }
  }

  const TileTree& tiles_;
  bool is_any_ = false;
  TileKey key_;
  std::array<const Tile*, 4> square_;  // of key_ and those next in x and y
  std::array<std::shared_ptr<const Tile>, 4> held_;
};

}  // namespace splinemap
