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
  std::vector<Eigen::Vector2d> points_m(grid.width);
  std::vector<SurfaceSample> samples(grid.width);
  for (int row = 0; row < grid.height; ++row) {
    const double y_m = grid.CentreY(row);
    for (int column = 0; column < grid.width; ++column)
      points_m[column] = {grid.CentreX(column), y_m};
    map.EvaluateMany(points_m, absl::MakeSpan(samples));
    for (const SurfaceSample& sample : samples)
      raster.pixels.push_back(sample.known ? KnownPixel(sample.log_odds) : Raster::kUnknown);
  }
  return raster;
}

void Raster::Mark(const Region& region, Marker marker) {
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
      marked[size_t{1} * row * grid.width + column] = marker;
    }
  }
}

namespace {

// A raster as libpng takes it.
struct PngSource {
  using Colour = std::array<png_byte, 3>;

  png_image image{};
  std::vector<Colour> colours;  // of the values of pixels, or, where any is marked, of each pixel
  const void* pixels = nullptr;
  int row_bytes = 0;

  explicit PngSource(const Raster& raster) {
    constexpr Colour kUnknownColour = {176, 190, 205};
    constexpr Colour kRed = {220, 30, 30};
    constexpr Colour kGreen = {20, 150, 60};
    colours.resize(256);
    for (int k = 0; k < 256; ++k) colours[k].fill(static_cast<png_byte>(k));
    colours[Raster::kUnknown] = kUnknownColour;
    image.version = PNG_IMAGE_VERSION;
    image.width = static_cast<png_uint_32>(raster.grid.width);
    image.height = static_cast<png_uint_32>(raster.grid.height);
    image.format = raster.marked.empty() ? PNG_FORMAT_RGB_COLORMAP : PNG_FORMAT_RGB;
    if (raster.marked.empty()) {
      image.colormap_entries = 256;
      pixels = raster.pixels.data();
      row_bytes = raster.grid.width;
      return;
    }
    std::vector<Colour> coloured;
    coloured.reserve(raster.pixels.size());
    for (size_t k = 0; k < raster.pixels.size(); ++k) {
      const Raster::Marker marker = raster.marked[k];
      coloured.push_back(marker == Raster::Marker::kRed     ? kRed
                         : marker == Raster::Marker::kGreen ? kGreen
                                                            : colours[raster.pixels[k]]);
    }
    colours = std::move(coloured);
    pixels = colours.data();
    row_bytes = 3 * raster.grid.width;
  }
};

}  // namespace

absl::Status WritePng(const Raster& raster, NewFile& file) {
  PngSource png(raster);
  if (png_image_write_to_stdio(&png.image, file.stream(), 0, png.pixels, png.row_bytes,
                               png.colours.data()) == 0) {
    return Unavailable("cannot write {}: {}", file.path(), png.image.message);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> EncodePng(const Raster& raster) {
  PngSource png(raster);
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(png.image);
  std::string bytes(size, '\0');
  if (png_image_write_to_memory(&png.image, bytes.data(), &size, 0, png.pixels, png.row_bytes,
                                png.colours.data()) == 0) {
    return Unavailable("cannot make a picture: {}", png.image.message);
  }
  bytes.resize(size);
  bytes.shrink_to_fit();  // the most that it might have been is much more
  return bytes;
}

}  // namespace splinemap
