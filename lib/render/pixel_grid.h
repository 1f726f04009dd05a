#pragma once

#include <optional>

#include "absl/status/statusor.h"
#include "splinemap/map_view.h"
#include "splinemap/region.h"

namespace splinemap {

// Square pixels over the map frame, rows from the top (greatest y) down. At most 2^28 pixels.
struct PixelGrid {
  int width = 0;
  int height = 0;
  double left_m = 0;  // x of the left edge
  double top_m = 0;   // y of the upper edge
  double pixel_m = 0;

  // The centre of a pixel, to the nanometre: so the same point is the same number in every grid.
  double CentreX(int column) const;
  double CentreY(int row) const;
  double bottom_m() const;  // y of the lower edge, to the nanometre
};

// The smallest grid over the control points that were touched, half a knot interval beyond the
// outermost. FailedPrecondition for a map without any, InvalidArgument for too many pixels.
absl::StatusOr<PixelGrid> FittingGrid(const MapView& map, double pixels_per_knot);

// Pixels per knot interval, 8 at most and a whole number from 1 on, with which the longer side of
// the picture has about `side` pixels.
double FittingPixelsPerKnot(const MapView& map, int side);

// The pixels of side `resolution_m` whose centres lie in `region`, by default in the touched part
// of the map. Centres are whole multiples of the resolution, so that grids of one resolution fit
// together, regions side by side share no pixel, and pixels of one knot interval are centred on the
// control points. FailedPrecondition for an empty map without a region; InvalidArgument for a
// region that is not finite, not ordered, beyond kMaxKnotIndex or without a pixel, for a resolution
// that is no number or under 1/64 knot interval, and for too many pixels.
absl::StatusOr<PixelGrid> GridOfRegion(const MapView& map, const std::optional<Region>& region,
                                       double resolution_m);

}  // namespace splinemap
