#pragma once

#include "lib/query/obstacle_search.h"
#include "splinemap/queries.h"

namespace splinemap {

// Require what Check() lets pass, and the search of the query's threshold and policy.

SweepsQuery::Result CheckSweep(ObstacleSearch& search, const Sweep& sweep, double knot_interval_m);

// To the nearest point that is occupied, or unknown where that stops the search.
DistancesQuery::Distance FindDistance(ObstacleSearch& search, const Eigen::Vector2d& point_m,
                                      double max_distance_m, double knot_interval_m);

}  // namespace splinemap
