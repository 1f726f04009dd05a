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

absl::Status WritePng(const Raster& raster, NewFile& file) {
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
  image.width = static_cast<png_uint_32>(raster.grid.width);
  image.height = static_cast<png_uint_32>(raster.grid.height);
  image.format = PNG_FORMAT_RGB_COLORMAP;
  image.colormap_entries = 256;
  if (png_image_write_to_stdio(&image, file.stream(), 0, raster.pixels.data(), raster.grid.width,
                               colours.data()) == 0) {
    return Unavailable("cannot write {}: {}", file.path(), image.message);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
