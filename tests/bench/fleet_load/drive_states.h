#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/layer_set.h"

namespace splinemap::bench {

// What a robot's layer was on a recorded drive.
struct DriveStates {
  MapOptions options;
  // Every `interval_s`, at 10 scans a second.
  std::vector<LayerSnapshot> states;
  int64_t scans = 0;
};

// Of a CARMEN log of the shared data folder, shifted by so many squares of 32 x 32 tiles.
absl::StatusOr<DriveStates> MapDrive(const std::string& log, double interval_s, int32_t squares_x,
                                     int32_t squares_y);

}  // namespace splinemap::bench
