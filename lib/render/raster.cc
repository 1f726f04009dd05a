#include "lib/render/raster.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr double kMaxPixels = 1 << 28;

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
    for (int k = 0; k < Tile::kSize; ++k) {
      if (entry.tile->control_points[k] == 0) continue;
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

}  // namespace

absl::StatusOr<Raster> RenderMap(const MapSnapshot& map, double pixels_per_knot) {
  const KnotBox box = TouchedBox(map.merged);
  if (box.empty()) return FailedPrecondition("the map is empty: no scan was mapped");
  const double knot_m = map.options.knot_interval_m;
  const double width = std::ceil(box.width() * pixels_per_knot);
  const double height = std::ceil(box.height() * pixels_per_knot);
  if (!(width >= 1 && height >= 1 && width * height <= kMaxPixels)) {
    return InvalidArgument("a picture of {:.0f} x {:.0f} pixels is too large; use fewer per knot",
                           width, height);
  }
  Raster raster;
  raster.width = static_cast<int>(width);
  raster.height = static_cast<int>(height);
  raster.left_m = (box.min_i - 0.5) * knot_m;
  raster.top_m = (box.max_j + 0.5) * knot_m;
  raster.pixel_m = knot_m / pixels_per_knot;
  raster.pixels.reserve(static_cast<size_t>(width * height));
  for (int row = 0; row < raster.height; ++row) {
    const double y_m = raster.top_m - (row + 0.5) * raster.pixel_m;
    for (int column = 0; column < raster.width; ++column) {
      const double x_m = raster.left_m + (column + 0.5) * raster.pixel_m;
      const SurfaceSample sample = map.Evaluate(x_m, y_m);
      raster.pixels.push_back(
          sample.known ? static_cast<uint8_t>(255 - std::lround(254 * Probability(sample.log_odds)))
                       : Raster::kUnknown);
    }
  }
  return raster;
}

double FittingPixelsPerKnot(const MapSnapshot& map, int side) {
  const KnotBox box = TouchedBox(map.merged);
  if (box.empty()) return 1;
  const double pixels_per_knot = side / std::max(box.width(), box.height());
  return pixels_per_knot < 1 ? pixels_per_knot : std::min(std::round(pixels_per_knot), 8.0);
}

absl::Status WritePng(const Raster& raster, const std::string& path) {
  std::array<png_byte, 3 * 256> colours;
  for (int k = 0; k < 256; ++k) {
    for (int channel = 0; channel < 3; ++channel) {
      colours[3 * k + channel] = static_cast<png_byte>(k);
    }
  }
  constexpr std::array<png_byte, 3> kUnknownColour = {176, 190, 205};
  std::copy(kUnknownColour.begin(), kUnknownColour.end(), colours.begin() + 3 * Raster::kUnknown);

  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(raster.width);
  image.height = static_cast<png_uint_32>(raster.height);
  image.format = PNG_FORMAT_RGB_COLORMAP;
  image.colormap_entries = 256;
  if (png_image_write_to_file(&image, path.c_str(), 0, raster.pixels.data(), raster.width,
                              colours.data()) == 0) {
    return Unavailable("cannot write {}: {}", path, image.message);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
