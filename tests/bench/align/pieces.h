#pragma once

#include <memory>
#include <string>
#include <vector>

#include "splinemap/map_view.h"
#include "splinemap/pose2.h"
#include "tests/support/recorded_drive.h"

namespace splinemap {

struct NamedDrive {
  std::string name;
  std::vector<RecordedScan> scans;
};

// Those of the shared data folder that are there, each of another building.
std::vector<NamedDrive> ReadBuildings();

// The map of the scans `first` to `last` - 1, at 0.05 m, of poses that were moved.
std::shared_ptr<const MapView> MapOfPiece(const NamedDrive& drive, size_t first, size_t last,
                                          const Pose2& map_T_world);

// The middle of the poses of these scans.
Eigen::Vector2d MiddleOf(const NamedDrive& drive, size_t first, size_t last);

// Of what the map with less of it knows, how much the other knows as well. Both in one frame.
double SharedPart(const MapView& a, const MapView& b);

}  // namespace splinemap
