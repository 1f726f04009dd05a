#include "lib/render/raster.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "lib/base/status.h"

namespace splinemap {

uint8_t KnownPixel(double log_odds) {
  return static_cast<uint8_t>(255 - std::lround(254 * Probability(log_odds)));
}

Raster RenderMap(const MapView& map, const PixelGrid& grid) {
  Raster raster;
  raster.grid = grid;
  raster.pixels.reserve(size_t{1} * grid.width * grid.height);
  for (int row = 0; row < grid.height; ++row) {
    const double y_m = grid.CentreY(row);
    for (int column = 0; column < grid.width; ++column) {
      const SurfaceSample sample = map.Evaluate(grid.CentreX(column), y_m);
      raster.pixels.push_back(sample.known ? KnownPixel(sample.log_odds) : Raster::kUnknown);
    }
  }
  return raster;
}

void Raster::Mark(const Region& region) {
  marked.resize(pixels.size());
  const auto column_of = [&](double x_m) { return (x_m - grid.left_m) / grid.pixel_m; };
  const auto row_of = [&](double y_m) { return (grid.top_m - y_m) / grid.pixel_m; };
  // The pixels [first, last] of those between two edges, and the middle one.
  const auto range = [](double begin, double end, int size) {
    const double middle = std::floor((begin + end) / 2);
    const double first = std::clamp(std::min(std::ceil(begin - 0.5), middle), 0.0, double(size));
    const double last = std::clamp(std::max(std::floor(end - 0.5), middle), -1.0, size - 1.0);
    return std::pair(static_cast<int>(first), static_cast<int>(last));
  };
  const auto [left, right] = range(column_of(region.x0_m), column_of(region.x1_m), grid.width);
  const auto [top, bottom] = range(row_of(region.y1_m), row_of(region.y0_m), grid.height);
  for (int row = top; row <= bottom; ++row) {
    for (int column = left; column <= right; ++column) {
      marked[size_t{1} * row * grid.width + column] = true;
    }
  }
}

absl::Status WritePng(const Raster& raster, NewFile& file) {
  using Colour = std::array<png_byte, 3>;
  constexpr Colour kUnknownColour = {176, 190, 205};
  constexpr Colour kMarkedColour = {220, 30, 30};
  std::array<Colour, 256> colours;
  for (int k = 0; k < 256; ++k) colours[k].fill(static_cast<png_byte>(k));
  colours[Raster::kUnknown] = kUnknownColour;

  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(raster.grid.width);
  image.height = static_cast<png_uint_32>(raster.grid.height);
  int written = 0;
  if (raster.marked.empty()) {
    image.format = PNG_FORMAT_RGB_COLORMAP;
    image.colormap_entries = 256;
    written = png_image_write_to_stdio(&image, file.stream(), 0, raster.pixels.data(),
                                       raster.grid.width, colours.data());
  } else {
    image.format = PNG_FORMAT_RGB;
    std::vector<Colour> pixels;
    pixels.reserve(raster.pixels.size());
    for (size_t k = 0; k < raster.pixels.size(); ++k) {
      pixels.push_back(raster.marked[k] ? kMarkedColour : colours[raster.pixels[k]]);
    }
    written = png_image_write_to_stdio(&image, file.stream(), 0, pixels.data(),
                                       3 * raster.grid.width, nullptr);
  }
  if (written == 0) return Unavailable("cannot write {}: {}", file.path(), image.message);
  return absl::OkStatus();
}

}  // namespace splinemap
