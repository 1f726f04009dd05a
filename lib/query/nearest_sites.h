#pragma once

#include <cstdint>
#include <vector>

#include "absl/functional/function_ref.h"

namespace splinemap {

// In eighths of a knot interval, from the corner of a tile.
struct Site {
  int32_t x;
  int32_t y;
};

// Vertices of the knot grid, counted from the corner of a tile: [x0, x1] x [y0, y1].
struct VertexBox {
  int x0;
  int y0;
  int x1;
  int y1;
};

// Finds the nearest of some sites for every vertex of a box, of those that are equally near the
// least by y and then by x: integers decide, so what it finds does not depend on the order of the
// sites. Halves the box until one site is left that is nearest to some point of it: of two sites,
// the one whose side of their bisector has nothing of the box is left out.
//
// Coordinates are up to 16,384 in amount, so that squares fit. Thread-compatible.
class NearestSites {
 public:
  using Visitor = absl::FunctionRef<void(int x, int y, const Site& nearest)>;

  // Before Find(): what can be nearest to a vertex of `box`, of all that is in `sites`.
  static void LeaveOut(std::vector<Site>& sites, const VertexBox& box);

  // Visits each vertex of `box` once; none where there are no sites.
  void Find(const std::vector<Site>& sites, const VertexBox& box, Visitor visit);

 private:
  void Split(size_t begin, size_t end, const VertexBox& box, Visitor visit);

  std::vector<Site> stack_;
};

}  // namespace splinemap
