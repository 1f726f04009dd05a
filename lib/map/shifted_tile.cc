#include "lib/map/shifted_tile.h"

#include <algorithm>

namespace splinemap {
namespace {

constexpr int kSide = Tile::kSide;

// The first and last tile that have control points [first, first + 32).
struct Span {
  int32_t begin;
  int32_t end;  // the last one
};
Span TilesFrom(int32_t first) { return {first >> 5, (first + kSide - 1) >> 5}; }

}  // namespace

std::vector<TileKey> KeysOfShifted(TileKey key, KnotShift shift) {
  const Span x = TilesFrom(kSide * key.tx + shift.i);
  const Span y = TilesFrom(kSide * key.ty + shift.j);
  std::vector<TileKey> keys;
  for (int32_t ty = y.begin; ty <= y.end; ++ty) {
    for (int32_t tx = x.begin; tx <= x.end; ++tx) {
      if (IsInRange({tx, ty})) keys.push_back({tx, ty});
    }
  }
  return keys;
}

const Tile* ShiftTile(const TileTree& layer, TileKey key, KnotShift shift, Tile& tile) {
  // Of the layer, the control points that come to the map's from (32 tx, 32 ty) on.
  const int32_t i0 = kSide * key.tx - shift.i;
  const int32_t j0 = kSide * key.ty - shift.j;
  const Span x = TilesFrom(i0);
  const Span y = TilesFrom(j0);
  bool is_there = false;
  for (int32_t ty = y.begin; ty <= y.end; ++ty) {
    for (int32_t tx = x.begin; tx <= x.end; ++tx) {
      const Tile* source = layer.Find({tx, ty});
      if (source == nullptr) continue;
      const int32_t i_begin = std::max(i0, kSide * tx);
      const int32_t i_end = std::min(i0, kSide * tx) + kSide;
      const int32_t j_begin = std::max(j0, kSide * ty);
      const int32_t j_end = std::min(j0, kSide * ty) + kSide;
      for (int32_t j = j_begin; j < j_end; ++j) {
        const ControlPoint* row = &source->control_points[IndexInTile(i_begin, j)];
        std::copy_n(row, i_end - i_begin, &tile.control_points[kSide * (j - j0) + i_begin - i0]);
        is_there = is_there ||
                   std::any_of(row, row + (i_end - i_begin), [](ControlPoint c) { return c != 0; });
      }
    }
  }
  return is_there ? &tile : nullptr;
}

}  // namespace splinemap
