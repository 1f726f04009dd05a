#pragma once

#include <Eigen/Core>
#include <chrono>
#include <vector>

#include "absl/status/statusor.h"
#include "splinemap/queryable_map.h"
#include "splinemap/region.h"

namespace splinemap {

using Path = std::vector<Eigen::Vector2d>;  // vertices in metres of the map frame

struct PlannerOptions {
  double radius_m = 0.2;     // of the robot, a disc
  double clearance_m = 0.6;  // nearer to obstacles than this, a metre costs more: up to kNearCost
  std::chrono::milliseconds improve_for{100};  // from the start on, once a path is found
  std::chrono::milliseconds give_up_after{2000};
};

// A path of the disc from `start_m` to `goal_m` through what the map knows to be free, within
// `bounds`: short, and clear of obstacles where that is no long way round. NotFound where none was
// found. Errors of the map are handed on.
absl::StatusOr<Path> PlanPath(const QueryableMap& map, const Region& bounds,
                              const Eigen::Vector2d& start_m, const Eigen::Vector2d& goal_m,
                              const PlannerOptions& options);

// Whether the disc can go along the path in this map.
absl::StatusOr<bool> IsFree(const QueryableMap& map, const Path& path, double radius_m);

}  // namespace splinemap
