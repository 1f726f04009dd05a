#include "lib/query/footprint.h"

#include <algorithm>
#include <cmath>

namespace splinemap {
namespace {

// Of a way that is looked at at once, in knot intervals: so the tiles around it are few.
constexpr double kMaxStep = Tile::kSide;
// Around a point, what is near is looked at first.
constexpr double kFirstReach = Tile::kSide / 2;

}  // namespace

SweepsQuery::Result CheckSweep(ObstacleSearch& search, const Sweep& sweep, double knot_interval_m) {
  SweepsQuery::Result result{.is_certified = true};
  const double radius = sweep.radius_m / knot_interval_m;
  double gone = 0;  // knot intervals, up to the segment
  for (size_t k = 0; k < std::max<size_t>(sweep.path_m.size() - 1, 1); ++k) {
    const Eigen::Vector2d from = sweep.path_m[k] / knot_interval_m;
    const Eigen::Vector2d to =
        sweep.path_m[std::min(k + 1, sweep.path_m.size() - 1)] / knot_interval_m;
    const double length = (to - from).norm();
    const auto at = [&](double way) {
      return Eigen::Vector2d(length > 0 ? from + (way / length) * (to - from) : from);
    };
    // Where there can be something to find, in whole steps of the segment: what else a map has,
    // elsewhere, changes no bit of the result.
    const ObstacleSearch::Way way = search.WayOverMap(from, to, radius);
    const double step = std::max(kMaxStep, radius);
    for (double number = std::floor(way.begin / step); number * step <= way.end; ++number) {
      const double begin = number * step;
      const double end = std::min(begin + step, length);
      const NearSweep ranking{at(begin), at(end), radius};
      const ObstacleSearch::Found found = search.First(ranking);
      result.is_certified = result.is_certified && found.is_certified;
      if (found.occupancy != Occupancy::kFree) {
        result.occupancy = found.occupancy;
        result.free_m = (gone + begin + found.rank) * knot_interval_m;
        result.contact_m = found.square.NearestTo(at(begin + found.rank)) * knot_interval_m;
        return result;
      }
      if (end == length) break;
    }
    gone += length;
  }
  result.free_m = gone * knot_interval_m;
  return result;
}

DistancesQuery::Distance FindDistance(ObstacleSearch& search, const Eigen::Vector2d& point_m,
                                      double max_distance_m, double knot_interval_m) {
  const Eigen::Vector2d point = point_m / knot_interval_m;
  const double max = max_distance_m / knot_interval_m;
  for (double reach = std::min(kFirstReach, max);; reach = std::min(2 * reach, max)) {
    const ObstacleSearch::Found found = search.Nearest({point, reach});
    if (found.occupancy != Occupancy::kFree) {
      const Eigen::Vector2d away = point - found.square.NearestTo(point);
      if (away.isZero(0)) return {};
      return {found.rank * knot_interval_m, away.normalized()};
    }
    if (reach == max) return {max_distance_m, Eigen::Vector2d::Zero()};
  }
}

}  // namespace splinemap
