#pragma once

#include "absl/status/status.h"
#include "lib/base/file.h"
#include "lib/render/pixel_grid.h"
#include "splinemap/map_view.h"

namespace splinemap {

// A header, then a line x_m,y_m,log_odds,probability,known for the centre of every pixel, from the
// lower left corner, x running fastest; known is 1 or 0, as in `splinemap query`.
absl::Status WriteCsv(const MapView& map, const PixelGrid& grid, NewFile& file);

}  // namespace splinemap
