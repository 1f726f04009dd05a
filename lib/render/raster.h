#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/base/file.h"
#include "lib/render/pixel_grid.h"
#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

// A picture of the merged surface, one byte per pixel of the grid.
struct Raster {
  static constexpr uint8_t kUnknown = 0;
  // Known pixels: 1 (certainly occupied) .. 255 (certainly free), linear in the probability.

  PixelGrid grid;
  std::vector<uint8_t> pixels;  // grid.width * grid.height

  enum class Marker : uint8_t { kNone, kRed, kGreen };
  std::vector<Marker> marked{};  // the same size, or empty: none is

  // Marks the pixels whose centres lie in `region`, at least the one that has its centre.
  void Mark(const Region& region, Marker marker = Marker::kRed);

  uint8_t at(int column, int row) const { return pixels[size_t{1} * row * grid.width + column]; }
};

// The pixel of a known point.
uint8_t KnownPixel(double log_odds);

// Evaluates the spline at the centre of each pixel.
Raster RenderMap(const MapView& map, const PixelGrid& grid);

// Unknown blue-grey, free white, occupied black, marked red or green.
absl::Status WritePng(const Raster& raster, NewFile& file);
absl::StatusOr<std::string> EncodePng(const Raster& raster);

}  // namespace splinemap
