#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/map/map.h"

namespace splinemap {

// A picture of the merged surface. One byte per pixel, rows from the top (greatest y) down.
struct Raster {
  static constexpr uint8_t kUnknown = 0;
  // Known pixels: 1 (certainly occupied) .. 255 (certainly free), linear in the probability.

  int width = 0;
  int height = 0;
  double left_m = 0;  // x of the left edge
  double top_m = 0;   // y of the upper edge
  double pixel_m = 0;
  std::vector<uint8_t> pixels;  // width * height

  uint8_t at(int column, int row) const { return pixels[size_t{1} * row * width + column]; }
};

// Evaluates the spline at the centre of each pixel of the smallest box of tiles' control points
// that were touched. FailedPrecondition for a map without any, InvalidArgument for more than 2^28
// pixels.
absl::StatusOr<Raster> RenderMap(const MapSnapshot& map, double pixels_per_knot);

// Pixels per knot interval, 8 at most and a whole number from 1 on, with which the longer side of
// the picture has about `side` pixels.
double FittingPixelsPerKnot(const MapSnapshot& map, int side);

// Unknown blue-grey, free white, occupied black.
absl::Status WritePng(const Raster& raster, const std::string& path);

}  // namespace splinemap
