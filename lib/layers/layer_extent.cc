#include "lib/layers/layer_extent.h"

#include <Eigen/Core>
#include <algorithm>
#include <limits>

#include "lib/geometry/angle.h"

namespace splinemap {

void LayerExtent::Set(TileKey key, const TouchedPoints& touched) {
  TouchedPoints& known = tiles_[key];
  points_ += touched.points - known.points;
  known = touched;
}

void LayerExtent::SetAll(const TileTree& tiles) {
  tiles.ForEach(
      [&](TileKey key, const TileTree::Entry& entry) { Set(key, entry.tile->Touched()); });
}

double LayerExtent::area_m2(double knot_interval_m) const {
  return static_cast<double>(points_) * knot_interval_m * knot_interval_m;
}

std::optional<Region> LayerExtent::Box(const FixedPose2& map_T_layer,
                                       double knot_interval_m) const {
  if (points_ == 0) return std::nullopt;
  const Pose2 pose = map_T_layer.ToPose();
  const Eigen::Vector2d x_axis = UnitVector(pose.yaw_rad);
  Eigen::Matrix2d turn;
  turn << x_axis.x(), -x_axis.y(), x_axis.y(), x_axis.x();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Eigen::Vector2d least(kInfinity, kInfinity);
  Eigen::Vector2d greatest = -least;
  for (const auto& [key, touched] : tiles_) {
    if (touched.points == 0) continue;
    const Eigen::Vector2d centre(Tile::kSide * key.tx + (touched.i0 + touched.i1) / 2.0,
                                 Tile::kSide * key.ty + (touched.j0 + touched.j1) / 2.0);
    const Eigen::Vector2d half((touched.i1 - touched.i0 + 1) / 2.0,
                               (touched.j1 - touched.j0 + 1) / 2.0);
    const Eigen::Vector2d of_map = turn * centre;
    const Eigen::Vector2d half_of_map = turn.cwiseAbs() * half;
    least = least.cwiseMin(of_map - half_of_map);
    greatest = greatest.cwiseMax(of_map + half_of_map);
  }
  least = pose.position_m + knot_interval_m * least;
  greatest = pose.position_m + knot_interval_m * greatest;
  return Region{least.x(), least.y(), greatest.x(), greatest.y()};
}

}  // namespace splinemap
