#include "lib/render/overlay.h"

#include <png.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "lib/base/status.h"

namespace splinemap {
namespace {

enum class Seen { kUnknown, kFree, kObstacle };

Seen SeenIn(const SurfaceSample& sample) {
  return !sample.known ? Seen::kUnknown : sample.log_odds < 0 ? Seen::kFree : Seen::kObstacle;
}

Overlay::Colour ColourOf(Seen in_a, Seen in_b) {
  if (in_a == Seen::kObstacle) {
    return in_b == Seen::kObstacle ? Overlay::kObstacle : Overlay::kObstacleInA;
  }
  if (in_b == Seen::kObstacle) return Overlay::kObstacleInB;
  if (in_a == Seen::kFree) return in_b == Seen::kFree ? Overlay::kFree : Overlay::kFreeInA;
  return in_b == Seen::kFree ? Overlay::kFreeInB : Overlay::kUnknown;
}

// Of the squares about the control points that were touched, each placed by itself: the corners of
// a box that is turned are far out.
Eigen::AlignedBox2d TouchedBox(const MapView& map, const Pose2& a_T_map) {
  Eigen::AlignedBox2d box;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const std::shared_ptr<const Tile> tile = entry.tile->Get();
    for (int k = 0; k < Tile::kSize; ++k) {
      if (tile->control_points[k] == 0) continue;
      const Eigen::Vector2d knot(Tile::kSide * key.tx + k % Tile::kSide,
                                 Tile::kSide * key.ty + k / Tile::kSide);
      for (const double dx : {-0.5, 0.5}) {
        for (const double dy : {-0.5, 0.5}) {
          box.extend(a_T_map * (map.options.knot_interval_m * (knot + Eigen::Vector2d(dx, dy))));
        }
      }
    }
  });
  return box;
}

}  // namespace

absl::StatusOr<PixelGrid> GridAroundBoth(const MapView& a, const MapView& b, const Pose2& a_T_b,
                                         int side) {
  Eigen::AlignedBox2d box = TouchedBox(a, {});
  const Eigen::AlignedBox2d box_b = TouchedBox(b, a_T_b);
  if (box.isEmpty() || box_b.isEmpty()) return FailedPrecondition("a map has nothing to draw");
  box.extend(box_b);
  const Eigen::Vector2d low_m = box.min();
  const Eigen::Vector2d high_m = box.max();
  constexpr double kFinest = 0.125;  // knot intervals
  const double knot_m = a.options.knot_interval_m;
  const double pixel_m = std::max((high_m - low_m).maxCoeff() / side, kFinest * knot_m);
  return GridOfRegion(a, Region{low_m.x(), low_m.y(), high_m.x(), high_m.y()}, pixel_m);
}

Overlay RenderBoth(const MapView& a, const MapView& b, const Pose2& a_T_b, const PixelGrid& grid) {
  Overlay overlay{grid, {}};
  overlay.pixels.reserve(size_t{1} * grid.width * grid.height);
  const Pose2 b_T_a = Inverse(a_T_b);
  const Eigen::Vector2d step_b_m =
      Pose2{Eigen::Vector2d::Zero(), b_T_a.yaw_rad} * Eigen::Vector2d(grid.pixel_m, 0);
  std::vector<Eigen::Vector2d> in_a_m(grid.width);
  std::vector<Eigen::Vector2d> in_b_m(grid.width);
  std::vector<SurfaceSample> of_a(grid.width);
  std::vector<SurfaceSample> of_b(grid.width);
  for (int row = 0; row < grid.height; ++row) {
    const double y_m = grid.CentreY(row);
    const Eigen::Vector2d first_b_m = b_T_a * Eigen::Vector2d(grid.CentreX(0), y_m);
    for (int column = 0; column < grid.width; ++column) {
      in_a_m[column] = {grid.CentreX(column), y_m};
      in_b_m[column] = first_b_m + column * step_b_m;
    }
    a.EvaluateMany(in_a_m, absl::MakeSpan(of_a));
    b.EvaluateMany(in_b_m, absl::MakeSpan(of_b));
    for (int column = 0; column < grid.width; ++column) {
      overlay.pixels.push_back(ColourOf(SeenIn(of_a[column]), SeenIn(of_b[column])));
    }
  }
  return overlay;
}

absl::Status WritePng(const Overlay& overlay, NewFile& file) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(overlay.grid.width);
  image.height = static_cast<png_uint_32>(overlay.grid.height);
  image.format = PNG_FORMAT_RGB;
  if (png_image_write_to_stdio(&image, file.stream(), 0, overlay.pixels.data(),
                               3 * overlay.grid.width, nullptr) == 0) {
    return Unavailable("cannot write {}: {}", file.path(), image.message);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
