#pragma once

#include <string>

#include "absl/status/status.h"
#include "clients/planner/path_planner.h"
#include "splinemap/map_view.h"

namespace splinemap {

// What to show over the map. Empty paths are left out.
struct PathPicture {
  Path before;  // orange
  Path now;     // blue, with the band that the robot takes
  double radius_m = 0;
  Eigen::Vector2d start_m;  // green
  Eigen::Vector2d goal_m;   // red
};

// Writes a PNG of about 1000 pixels on its longer side, whole or not at all. FailedPrecondition for
// an empty map.
absl::Status WritePicture(const MapView& map, const PathPicture& picture, const std::string& file);

}  // namespace splinemap
