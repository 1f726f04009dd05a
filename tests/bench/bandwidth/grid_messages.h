#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "splinemap/map_view.h"

namespace splinemap::bench {

struct MessageBytes {
  double raw = 0;
  double zstd = 0;  // of level 3, as splinemap's tiles
};

// The map as an occupancy grid, as ROS and others send it: an int8 per cell of a knot interval,
// probability in per cent at its centre, -1 unknown; and what messages with it take.
class GridMessages {
 public:
  // Of a map within `bounds`.
  GridMessages(const Eigen::AlignedBox2d& bounds_m, const MapOptions& options);

  // Brings the grid up to date.
  void Update(const MapView& map);

  // A message with all cells from the first known one to the last, each way.
  MessageBytes Whole() const { return Message(known_); }
  // A message with the bounding box of what has changed since the last call; none if nothing has.
  MessageBytes DrainChanged();

 private:
  using Box = Eigen::AlignedBox2i;
  void UpdateTile(TileKey key, const MapView& map);
  MessageBytes Message(const Box& box) const;

  double cell_m_;
  Box bounds_;  // cells of the map frame, both corners included
  std::vector<int8_t> cells_;
  Box known_;
  Box changed_;
  uint64_t version_ = 0;  // of the tree of the last Update()
};

}  // namespace splinemap::bench
