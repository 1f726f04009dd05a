#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace splinemap {

// In eighths of a knot interval, from the corner of a tile.
struct Site {
  static constexpr int kUnits = 8;

  int32_t x;
  int32_t y;
  bool operator==(const Site&) const = default;
};

// 8 x 8 vertices of the knot grid, (x0, y0) the first of them, counted from the corner of a tile.
struct VertexBlock {
  static constexpr int kSide = 8;
  static constexpr int kSize = kSide * kSide;

  int x0;
  int y0;
};

// Leaves out sites that are nearest to no point of the block, whatever others there are: of two
// sites, one whose side of their bisector has nothing of the block.
void LeaveOutHidden(std::vector<Site>& sites, const VertexBlock& block);

// Of each vertex of the block, x runs fastest, the nearest site; of those that are equally near the
// least by y and then by x. Orders the sites so, of which there is one at least. Integers decide:
// it does not matter in which order the sites came. Coordinates are up to 20,000 in amount.
std::array<Site, VertexBlock::kSize> NearestSites(std::vector<Site>& sites,
                                                  const VertexBlock& block);

}  // namespace splinemap
