#include "splinemap/local_map.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/query/footprint.h"
#include "lib/query/obstacle_search.h"
#include "lib/query/ray_caster.h"
#include "lib/query/surface_bounds.h"

namespace splinemap {
namespace {

// log p(occupied), also where p is too small for a double.
double LogProbability(double log_odds) {
  return log_odds > 0 ? -std::log1p(std::exp(-log_odds))
                      : log_odds - std::log1p(std::exp(log_odds));
}

}  // namespace

class LocalMap::Impl {
 public:
  explicit Impl(std::shared_ptr<const MapView> map) : map_(std::move(map)) {}

  void Use(std::shared_ptr<const MapView> map) {
    MutexLock lock(mutex_);
    map_ = std::move(map);
  }
  std::shared_ptr<const MapView> View() const {
    MutexLock lock(mutex_);
    return map_;
  }
  // Gives `other`, which has the same map, the bounds that were made for it.
  void ShareBounds(Impl& other) const {
    MutexLock lock(bounds_mutex_);
    MutexLock other_lock(other.bounds_mutex_);
    if (bounds_ && bounds_->map() == other.View()) other.bounds_ = bounds_;
  }

  absl::StatusOr<PointsQuery::Answer> Answer(const PointsQuery& query) const;
  absl::StatusOr<RaysQuery::Answer> Answer(const RaysQuery& query) const;
  absl::StatusOr<SweepsQuery::Answer> Answer(const SweepsQuery& query) const;
  absl::StatusOr<RasterQuery::Answer> Answer(const RasterQuery& query) const;
  absl::StatusOr<LikelihoodsQuery::Answer> Answer(const LikelihoodsQuery& query) const;
  absl::StatusOr<DistancesQuery::Answer> Answer(const DistancesQuery& query) const;

 private:
  SurfaceBounds Bounds() const {
    auto map = View();
    MutexLock lock(bounds_mutex_);
    // What was kept for a copy is gone once the map that it was copied from went on.
    if (!bounds_ || !bounds_->KeepsBounds()) bounds_.emplace(map);
    bounds_->Use(std::move(map));
    return *bounds_;
  }

  mutable Mutex mutex_;
  std::shared_ptr<const MapView> map_ ABSL_GUARDED_BY(mutex_);
  // One of its own, so that neither Use() nor other queries wait while bounds are made.
  mutable Mutex bounds_mutex_;
  mutable std::optional<SurfaceBounds> bounds_ ABSL_GUARDED_BY(bounds_mutex_);
};

LocalMap::LocalMap(std::shared_ptr<const MapView> map)
    : impl_(std::make_unique<Impl>(std::move(map))) {}
LocalMap::~LocalMap() = default;

void LocalMap::Use(std::shared_ptr<const MapView> map) { impl_->Use(std::move(map)); }

std::shared_ptr<const MapView> LocalMap::View() const { return impl_->View(); }

std::shared_ptr<const LocalMap> LocalMap::Keep() const {
  auto kept = std::make_shared<LocalMap>(View());
  impl_->ShareBounds(*kept->impl_);
  return kept;
}

absl::StatusOr<AnyAnswer> LocalMap::AskAny(const AnyQuery& query) const {
  return std::visit(
      [this](const auto* q) -> absl::StatusOr<AnyAnswer> {
        SPLINEMAP_RETURN_IF_ERROR(Check(*q));
        return impl_->Answer(*q);
      },
      query);
}

absl::StatusOr<PointsQuery::Answer> LocalMap::Impl::Answer(const PointsQuery& query) const {
  const auto map = View();
  PointsQuery::Answer answer;
  answer.revision = map->revision;
  answer.samples.resize(query.points_m.size());
  map->EvaluateMany(query.points_m, absl::MakeSpan(answer.samples));
  if (!query.with_hessians) return answer;
  answer.hessians_per_m2.reserve(query.points_m.size());
  for (const Eigen::Vector2d& point_m : query.points_m) {
    answer.hessians_per_m2.push_back(map->Hessian(point_m.x(), point_m.y()));
  }
  return answer;
}

absl::StatusOr<RaysQuery::Answer> LocalMap::Impl::Answer(const RaysQuery& query) const {
  const SurfaceBounds bounds = Bounds();
  RaysQuery::Answer answer;
  answer.revision = bounds.map()->revision;
  answer.ends.reserve(query.rays.size());
  RayCaster caster(bounds, query.occupied_log_odds, query.unknown);
  for (const Ray& ray : query.rays) answer.ends.push_back(caster.Cast(ray));
  return answer;
}

absl::StatusOr<SweepsQuery::Answer> LocalMap::Impl::Answer(const SweepsQuery& query) const {
  const SurfaceBounds bounds = Bounds();
  SweepsQuery::Answer answer;
  answer.revision = bounds.map()->revision;
  answer.results.reserve(query.sweeps.size());
  ObstacleSearch search(bounds, query.occupied_log_odds, query.unknown);
  for (const Sweep& sweep : query.sweeps) {
    answer.results.push_back(CheckSweep(search, sweep, bounds.map()->options.knot_interval_m));
  }
  return answer;
}

absl::StatusOr<RasterQuery::Answer> LocalMap::Impl::Answer(const RasterQuery& query) const {
  const auto map = View();
  RasterQuery::Answer answer;
  answer.revision = map->revision;
  answer.cells.reserve(size_t{1} * query.width * query.height);
  std::vector<Eigen::Vector2d> centres_m(query.width);
  std::vector<SurfaceSample> samples(query.width);
  for (int row = 0; row < query.height; ++row) {
    for (int column = 0; column < query.width; ++column) {
      centres_m[column] = PointOfCell(query, size_t{1} * row * query.width + column);
    }
    map->EvaluateMany(centres_m, absl::MakeSpan(samples));
    std::transform(samples.begin(), samples.end(), std::back_inserter(answer.cells), CellOf);
  }
  return answer;
}

absl::StatusOr<LikelihoodsQuery::Answer> LocalMap::Impl::Answer(
    const LikelihoodsQuery& query) const {
  const auto map = View();
  LikelihoodsQuery::Answer answer;
  answer.revision = map->revision;
  answer.log_likelihoods.reserve(query.world_T_robot.size());
  std::vector<Eigen::Vector2d> hits_m(query.hits_robot_m.size());
  std::vector<SurfaceSample> samples(query.hits_robot_m.size());
  for (const Pose2& world_T_robot : query.world_T_robot) {
    for (size_t k = 0; k < hits_m.size(); ++k) hits_m[k] = world_T_robot * query.hits_robot_m[k];
    map->EvaluateMany(hits_m, absl::MakeSpan(samples));
    double sum = 0;
    for (const SurfaceSample& sample : samples) sum += LogProbability(sample.log_odds);
    answer.log_likelihoods.push_back(sum);
  }
  return answer;
}

absl::StatusOr<DistancesQuery::Answer> LocalMap::Impl::Answer(const DistancesQuery& query) const {
  const SurfaceBounds bounds = Bounds();
  DistancesQuery::Answer answer;
  answer.revision = bounds.map()->revision;
  answer.distances.reserve(query.points_m.size());
  ObstacleSearch search(bounds, query.occupied_log_odds, UnknownPolicy::kFree);
  for (const Eigen::Vector2d& point_m : query.points_m) {
    answer.distances.push_back(
        FindDistance(search, point_m, query.max_distance_m, bounds.map()->options.knot_interval_m));
  }
  return answer;
}

}  // namespace splinemap
