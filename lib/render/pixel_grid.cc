#include "lib/render/pixel_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr double kMaxPixels = 1 << 28;
constexpr double kMaxPixelsPerKnot = 64;

struct KnotBox {
  int32_t min_i = std::numeric_limits<int32_t>::max();
  int32_t min_j = std::numeric_limits<int32_t>::max();
  int32_t max_i = std::numeric_limits<int32_t>::min();
  int32_t max_j = std::numeric_limits<int32_t>::min();

  bool empty() const { return min_i > max_i; }
  // In knot intervals, half of one beyond the outermost control points.
  double width() const { return double{1} + max_i - min_i; }
  double height() const { return double{1} + max_j - min_j; }
};

KnotBox TouchedBox(const TileTree& tiles) {
  KnotBox box;
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const std::shared_ptr<const Tile> tile = entry.tile->Get();
    for (int k = 0; k < Tile::kSize; ++k) {
      if (tile->control_points[k] == 0) continue;
      const int32_t i = key.tx * Tile::kSide + k % Tile::kSide;
      const int32_t j = key.ty * Tile::kSide + k / Tile::kSide;
      box.min_i = std::min(box.min_i, i);
      box.max_i = std::max(box.max_i, i);
      box.min_j = std::min(box.min_j, j);
      box.max_j = std::max(box.max_j, j);
    }
  });
  return box;
}

absl::Status EmptyMap() { return FailedPrecondition("the map is empty: no scan was mapped"); }

absl::StatusOr<PixelGrid> MakeGrid(double width, double height, double left_m, double top_m,
                                   double pixel_m) {
  if (!(width * height <= kMaxPixels)) {
    return InvalidArgument(
        "a picture of {:.0f} x {:.0f} pixels is too large, {:.0f} are the most; use larger pixels "
        "or a smaller region",
        width, height, kMaxPixels);
  }
  return PixelGrid{static_cast<int>(width), static_cast<int>(height), left_m, top_m, pixel_m};
}

double ToNanometre(double coordinate_m) { return std::round(coordinate_m * 1e9) / 1e9; }

// The first multiple of the resolution that is not below a coordinate, which may miss it by a
// rounding.
double FirstPixel(double coordinate_m, double resolution_m) {
  return std::ceil(coordinate_m / resolution_m - 1e-6);
}

absl::Status CheckRegion(const Region& region, double knot_interval_m) {
  const double limit_m = kMaxKnotIndex * knot_interval_m;
  for (const double coordinate_m : {region.x0_m, region.y0_m, region.x1_m, region.y1_m}) {
    if (!(std::abs(coordinate_m) <= limit_m)) {
      return InvalidArgument(
          "the region reaches to {} m; coordinates of this map end at +-{:.0f} m", coordinate_m,
          limit_m);
    }
  }
  if (!(region.x0_m < region.x1_m && region.y0_m < region.y1_m)) {
    return InvalidArgument(
        "the region from ({}, {}) to ({}, {}) m is empty; give the lower left corner first",
        region.x0_m, region.y0_m, region.x1_m, region.y1_m);
  }
  return absl::OkStatus();
}

}  // namespace

double PixelGrid::CentreX(int column) const {
  return ToNanometre(left_m + (column + 0.5) * pixel_m);
}
double PixelGrid::CentreY(int row) const { return ToNanometre(top_m - (row + 0.5) * pixel_m); }
double PixelGrid::bottom_m() const { return ToNanometre(top_m - height * pixel_m); }

absl::StatusOr<PixelGrid> FittingGrid(const MapView& map, double pixels_per_knot) {
  const KnotBox box = TouchedBox(map.tiles);
  if (box.empty()) return EmptyMap();
  const double knot_m = map.options.knot_interval_m;
  return MakeGrid(std::ceil(box.width() * pixels_per_knot),
                  std::ceil(box.height() * pixels_per_knot), (box.min_i - 0.5) * knot_m,
                  (box.max_j + 0.5) * knot_m, knot_m / pixels_per_knot);
}

double FittingPixelsPerKnot(const MapView& map, int side) {
  const KnotBox box = TouchedBox(map.tiles);
  if (box.empty()) return 1;
  const double pixels_per_knot = side / std::max(box.width(), box.height());
  return pixels_per_knot < 1 ? pixels_per_knot : std::min(std::round(pixels_per_knot), 8.0);
}

absl::StatusOr<PixelGrid> GridOfRegion(const MapView& map, const std::optional<Region>& region,
                                       double resolution_m) {
  const double knot_m = map.options.knot_interval_m;
  if (!(std::isfinite(resolution_m) && resolution_m >= knot_m / kMaxPixelsPerKnot)) {
    return InvalidArgument("the resolution is {} m per pixel; the finest is {} m", resolution_m,
                           knot_m / kMaxPixelsPerKnot);
  }
  Region shown;
  if (region) {
    SPLINEMAP_RETURN_IF_ERROR(CheckRegion(*region, knot_m));
    shown = *region;
  } else {
    const KnotBox box = TouchedBox(map.tiles);
    if (box.empty()) return EmptyMap();
    shown = {(box.min_i - 0.5) * knot_m, (box.min_j - 0.5) * knot_m, (box.max_i + 0.5) * knot_m,
             (box.max_j + 0.5) * knot_m};
  }
  const double left = FirstPixel(shown.x0_m, resolution_m);
  const double bottom = FirstPixel(shown.y0_m, resolution_m);
  const double right = FirstPixel(shown.x1_m, resolution_m);
  const double top = FirstPixel(shown.y1_m, resolution_m);
  if (left == right || bottom == top) {
    return InvalidArgument(
        "the region from ({}, {}) to ({}, {}) m has no centre of a pixel of {} m", shown.x0_m,
        shown.y0_m, shown.x1_m, shown.y1_m, resolution_m);
  }
  return MakeGrid(right - left, top - bottom, ToNanometre((left - 0.5) * resolution_m),
                  ToNanometre((top - 0.5) * resolution_m), resolution_m);
}

}  // namespace splinemap
