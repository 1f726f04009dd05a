#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"
#include "splinemap/pose2.h"
#include "splinemap/tile_tree.h"

namespace splinemap {

// The cells of a map of map_server, as nav2_map_server reads them, from the lower left, x fastest.
struct RosGrid {
  static constexpr uint8_t kUnknown = 255;
  static constexpr double kMaxCells = 1e8;

  std::string image_path;
  int width = 0;
  int height = 0;
  double cell_m = 0;
  Pose2 map_T_grid;               // the grid's origin is the lower left corner of its first cell
  std::vector<uint8_t> per_cent;  // probability of occupied, 0 .. 100, or kUnknown
};

// Reads MAP.yaml and its picture, a PNG or binary PGM of 8 bits. Pixels that are not opaque are
// unknown in every mode. Errors name the file and what is wrong: NotFound, InvalidArgument.
absl::StatusOr<RosGrid> ReadRosGrid(const std::string& yaml_path);

// What a cell of certainty weighs, in log-odds; less certain cells weigh as their probability says.
// At the defaults a single occupied cell among free ones, which the surface smooths, is above 0,
// and free cells beside a wall still are free to map_server (below a probability of 0.196); and yet
// a robot, whose layer has -8 to 6, overrules them where it looks.
struct CellWeights {
  double occupied_log_odds = 3.2;
  double free_log_odds = -2.5;
};

// Control points of a surface that has the cells' values: each is the greatest log-odds within half
// a knot interval, where unknown counts as 0, so that thin walls stay, however grid and knots lie,
// and unknown cells stay unknown. Requires weights of the signs of the defaults, within the limits.
// InvalidArgument for cells that are too small for the knot interval, too many control points, or a
// grid beyond kMaxKnotIndex.
absl::StatusOr<TileTree> TilesOf(const RosGrid& grid, const CellWeights& weights,
                                 const MapOptions& options);

}  // namespace splinemap
