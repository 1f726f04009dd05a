#include "splinemap/queries.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "lib/base/status.h"
#include "splinemap/tile.h"

namespace splinemap {
namespace {

absl::Status CheckFinite(const std::vector<Eigen::Vector2d>& points_m, const char* of) {
  for (size_t k = 0; k < points_m.size(); ++k) {
    if (!points_m[k].allFinite()) {
      return InvalidArgument("{} {} is ({}, {})", of, k, points_m[k].x(), points_m[k].y());
    }
  }
  return absl::OkStatus();
}

absl::Status CheckThreshold(double occupied_log_odds) {
  if (std::isfinite(occupied_log_odds)) return absl::OkStatus();
  return InvalidArgument("occupied_log_odds is {}", occupied_log_odds);
}

absl::Status CheckPolicy(UnknownPolicy unknown) {
  if (unknown == UnknownPolicy::kBlocked || unknown == UnknownPolicy::kFree)
    return absl::OkStatus();
  return InvalidArgument("unknown is {}, neither 0 nor 1", static_cast<int>(unknown));
}

absl::Status CheckSweep(const Sweep& sweep, size_t number) {
  if (sweep.path_m.empty() || sweep.path_m.size() > Sweep::kMaxVertices) {
    return InvalidArgument("sweep {} has {} vertices; 1 to {} are allowed", number,
                           sweep.path_m.size(), Sweep::kMaxVertices);
  }
  if (!(sweep.radius_m >= 0 && sweep.radius_m <= Sweep::kMaxRadius_m)) {
    return InvalidArgument("radius_m of sweep {} is {}; 0 to {} is allowed", number, sweep.radius_m,
                           Sweep::kMaxRadius_m);
  }
  for (const Eigen::Vector2d& vertex_m : sweep.path_m) {
    if (vertex_m.cwiseAbs().maxCoeff() > Sweep::kMaxCoordinate_m) {
      return InvalidArgument("sweep {} has a vertex at ({}, {}) m; {} m is the most", number,
                             vertex_m.x(), vertex_m.y(), Sweep::kMaxCoordinate_m);
    }
  }
  return CheckFinite(sweep.path_m, fmt::format("of sweep {}, vertex", number).c_str());
}

}  // namespace

std::vector<Ray> RaysOfScan(const Pose2& world_T_sensor, const std::vector<double>& bearings_rad,
                            double max_range_m) {
  std::vector<Ray> rays;
  rays.reserve(bearings_rad.size());
  for (const double bearing_rad : bearings_rad) {
    rays.push_back({world_T_sensor.position_m, world_T_sensor.yaw_rad + bearing_rad, max_range_m});
  }
  return rays;
}

Eigen::Vector2d PointOfCell(const RasterQuery& query, size_t cell) {
  const size_t width = query.width;
  return query.first_m + query.resolution_m * Eigen::Vector2d(static_cast<double>(cell % width),
                                                              static_cast<double>(cell / width));
}

int16_t CellOf(const SurfaceSample& sample) {
  if (!sample.known) return 0;
  const double units = std::round(sample.log_odds * kUnitsPerLogOdds);
  constexpr double kMax = std::numeric_limits<int16_t>::max();
  const auto cell = static_cast<int16_t>(std::clamp(units, -kMax, kMax));
  return cell == 0 ? int16_t{1} : cell;
}

absl::Status Check(const PointsQuery&) { return absl::OkStatus(); }

absl::Status Check(const RaysQuery& query) {
  SPLINEMAP_RETURN_IF_ERROR(CheckThreshold(query.occupied_log_odds));
  SPLINEMAP_RETURN_IF_ERROR(CheckPolicy(query.unknown));
  for (size_t k = 0; k < query.rays.size(); ++k) {
    const Ray& ray = query.rays[k];
    const bool is_valid = ray.origin_m.allFinite() && std::isfinite(ray.bearing_rad) &&
                          ray.max_range_m >= 0 && std::isfinite(ray.max_range_m);
    if (!is_valid) {
      return InvalidArgument("ray {} is from ({}, {}) m along {} rad for {} m", k, ray.origin_m.x(),
                             ray.origin_m.y(), ray.bearing_rad, ray.max_range_m);
    }
  }
  return absl::OkStatus();
}

absl::Status Check(const SweepsQuery& query) {
  SPLINEMAP_RETURN_IF_ERROR(CheckThreshold(query.occupied_log_odds));
  SPLINEMAP_RETURN_IF_ERROR(CheckPolicy(query.unknown));
  for (size_t k = 0; k < query.sweeps.size(); ++k) {
    SPLINEMAP_RETURN_IF_ERROR(CheckSweep(query.sweeps[k], k));
  }
  return absl::OkStatus();
}

absl::Status Check(const RasterQuery& query) {
  if (!query.first_m.allFinite() || !(query.resolution_m > 0) ||
      !std::isfinite(query.resolution_m)) {
    return InvalidArgument("raster from ({}, {}) m with cells of {} m", query.first_m.x(),
                           query.first_m.y(), query.resolution_m);
  }
  if (query.width < 1 || query.height < 1 ||
      int64_t{query.width} * query.height > RasterQuery::kMaxCells) {
    return InvalidArgument("raster of {} x {} cells; 1 to {} cells are allowed", query.width,
                           query.height, RasterQuery::kMaxCells);
  }
  return absl::OkStatus();
}

absl::Status Check(const LikelihoodsQuery& query) {
  if (query.hits_robot_m.size() > LikelihoodsQuery::kMaxHits) {
    return InvalidArgument("scan of {} hits; {} are allowed", query.hits_robot_m.size(),
                           LikelihoodsQuery::kMaxHits);
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckFinite(query.hits_robot_m, "hit"));
  for (size_t k = 0; k < query.world_T_robot.size(); ++k) {
    const Pose2& pose = query.world_T_robot[k];
    if (!pose.position_m.allFinite() || !std::isfinite(pose.yaw_rad)) {
      return InvalidArgument("pose {} is ({}, {}) m, {} rad", k, pose.position_m.x(),
                             pose.position_m.y(), pose.yaw_rad);
    }
  }
  return absl::OkStatus();
}

absl::Status Check(const DistancesQuery& query) {
  SPLINEMAP_RETURN_IF_ERROR(CheckThreshold(query.occupied_log_odds));
  if (!(query.max_distance_m >= 0 && query.max_distance_m <= DistancesQuery::kMaxDistance_m)) {
    return InvalidArgument("max_distance_m is {}; 0 to {} is allowed", query.max_distance_m,
                           DistancesQuery::kMaxDistance_m);
  }
  return CheckFinite(query.points_m, "point");
}

}  // namespace splinemap
