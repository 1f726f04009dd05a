#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/base/file.h"
#include "lib/render/pixel_grid.h"
#include "splinemap/map_view.h"

namespace splinemap {

// How map_server and nav2_map_server read a pixel of the picture into a cell of an OccupancyGrid,
// 0 .. 100 or -1 for unknown. With occ = (255 - pixel) / 255:
enum class RosMode {
  // occ > occupied_thresh: 100; occ < free_thresh: 0; else unknown. As map_saver writes it: 0, 254,
  // 205. A known point whose probability is not beyond either threshold is written as unknown.
  kTrinary,
  // The cell is the probability in per cent, unknown is transparent: a PNG, since PGM cannot.
  kScale,
  // The pixel is the cell: the probability in per cent, 255 for unknown.
  kRaw,
};

// As the .yaml says it.
const char* NameOf(RosMode mode);

// With the dot.
std::string RosImageExtension(RosMode mode);

// The picture, with the surface at the centre of each pixel. ROS counts cells from the lower left,
// pictures from the upper left; the readers turn it.
absl::Status WriteRosImage(const MapView& map, const PixelGrid& grid, RosMode mode, NewFile& file);

// The content of the .yaml for a picture `image` in the same folder. Its numbers read back exactly.
// InvalidArgument for a name with control characters.
absl::StatusOr<std::string> RosYaml(const PixelGrid& grid, RosMode mode, const std::string& image);

}  // namespace splinemap
