#pragma once

#include "absl/status/status.h"
#include "lib/base/file.h"
#include "lib/render/pixel_grid.h"
#include "splinemap/map_view.h"

namespace splinemap {

// A GeoTIFF 1.0 of one band: the log-odds of occupied as float32, NaN and GDAL's nodata
// where unknown. Model coordinates are the map frame, metres, in no reference system of the earth.
absl::Status WriteGeoTiff(const MapView& map, const PixelGrid& grid, NewFile& file);

}  // namespace splinemap
