#include "tests/support/queries.h"

#include <algorithm>
#include <bit>

#include "tests/support/map_writer.h"
#include "tests/support/random_map.h"

namespace splinemap {
namespace {

double Uniform(std::mt19937_64& random, double min, double max) {
  return std::uniform_real_distribution<double>(min, max)(random);
}

Eigen::Vector2d RandomPoint(std::mt19937_64& random) {
  return {Uniform(random, -12, 12), Uniform(random, -12, 12)};
}

bool Same(double a, double b) { return std::bit_cast<uint64_t>(a) == std::bit_cast<uint64_t>(b); }
bool Same(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return Same(a.x(), b.x()) && Same(a.y(), b.y());
}

template <typename Items, typename IsSame>
bool AllSame(const Items& a, const Items& b, IsSame is_same) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), is_same);
}

}  // namespace

std::shared_ptr<const MapView> RandomMap(uint64_t seed) {
  std::mt19937_64 random(seed);
  MapWriter map({0.05, {-2560, 2560}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  for (int commits = 0; commits < 20; ++commits) {
    layer.BeginCommit();
    for (int k = 0; k < 5; ++k) {
      layer.EditTile(RandomKey(random, 6)) = RandomTile(random, map.options().limits);
    }
  }
  return map.View();
}

PointsQuery RandomPoints(std::mt19937_64& random, size_t size) {
  PointsQuery query;
  query.with_hessians = size % 2 == 1;
  for (size_t k = 0; k < size; ++k) query.points_m.push_back(RandomPoint(random));
  if (size > 2) query.points_m[1] = {1e300, -1e9};
  return query;
}

RaysQuery RandomRays(std::mt19937_64& random, size_t size) {
  RaysQuery query;
  query.occupied_log_odds = Uniform(random, -1, 1);
  query.unknown = size % 2 == 1 ? UnknownPolicy::kFree : UnknownPolicy::kBlocked;
  for (size_t k = 0; k < size; ++k) {
    query.rays.push_back({RandomPoint(random), Uniform(random, -4, 4), Uniform(random, 0, 20)});
  }
  return query;
}

SweepsQuery RandomSweeps(std::mt19937_64& random, size_t size) {
  SweepsQuery query;
  query.unknown = size % 2 == 1 ? UnknownPolicy::kFree : UnknownPolicy::kBlocked;
  for (size_t k = 0; k < size; ++k) {
    Sweep& sweep = query.sweeps.emplace_back();
    sweep.radius_m = Uniform(random, 0, 0.3);
    Eigen::Vector2d at_m = RandomPoint(random);
    for (size_t vertices = 1 + random() % 30; vertices > 0; --vertices) {
      sweep.path_m.push_back(at_m);
      at_m += Eigen::Vector2d{Uniform(random, -0.5, 0.5), Uniform(random, -0.5, 0.5)};  // in order
    }
  }
  return query;
}

RasterQuery RandomRaster(std::mt19937_64& random, size_t size) {
  const auto width = static_cast<int32_t>(1 + random() % std::max<size_t>(size, 1));
  return {.first_m = RandomPoint(random),
          .resolution_m = Uniform(random, 0.01, 0.1),
          .width = width,
          .height = static_cast<int32_t>(size / width + 1)};
}

LikelihoodsQuery RandomLikelihoods(std::mt19937_64& random, size_t size) {
  LikelihoodsQuery query;
  for (int k = 0; k < 400; ++k) query.hits_robot_m.push_back(RandomPoint(random) / 3);
  for (size_t k = 0; k < size; ++k) {
    query.world_T_robot.push_back({RandomPoint(random), Uniform(random, -4, 4)});
  }
  return query;
}

DistancesQuery RandomDistances(std::mt19937_64& random, size_t size) {
  DistancesQuery query;
  query.occupied_log_odds = Uniform(random, -1, 1);
  for (size_t k = 0; k < size; ++k) query.points_m.push_back(RandomPoint(random));
  return query;
}

bool AreSame(const PointsQuery::Answer& a, const PointsQuery::Answer& b) {
  const auto same_hessian = [](const Eigen::Matrix2d& x, const Eigen::Matrix2d& y) {
    return Same(x(0, 0), y(0, 0)) && Same(x(0, 1), y(0, 1)) && Same(x(1, 0), y(1, 0)) &&
           Same(x(1, 1), y(1, 1));
  };
  return a.revision == b.revision && AllSame(a.hessians_per_m2, b.hessians_per_m2, same_hessian) &&
         AllSame(a.samples, b.samples, [](const SurfaceSample& x, const SurfaceSample& y) {
           return Same(x.gradient_per_m, y.gradient_per_m) && Same(x.log_odds, y.log_odds) &&
                  x.known == y.known;
         });
}

bool AreSame(const RaysQuery::Answer& a, const RaysQuery::Answer& b) {
  return a.revision == b.revision && AllSame(a.ends, b.ends, [](const auto& x, const auto& y) {
           return x.occupancy == y.occupancy && Same(x.range_m, y.range_m);
         });
}

bool AreSame(const SweepsQuery::Answer& a, const SweepsQuery::Answer& b) {
  return a.revision == b.revision &&
         AllSame(a.results, b.results, [](const auto& x, const auto& y) {
           return x.occupancy == y.occupancy && x.is_certified == y.is_certified &&
                  Same(x.free_m, y.free_m) && Same(x.contact_m, y.contact_m);
         });
}

bool AreSame(const RasterQuery::Answer& a, const RasterQuery::Answer& b) {
  return a.revision == b.revision && a.cells == b.cells;
}

bool AreSame(const LikelihoodsQuery::Answer& a, const LikelihoodsQuery::Answer& b) {
  return a.revision == b.revision && AllSame(a.log_likelihoods, b.log_likelihoods,
                                             [](double x, double y) { return Same(x, y); });
}

bool AreSame(const DistancesQuery::Answer& a, const DistancesQuery::Answer& b) {
  return a.revision == b.revision &&
         AllSame(a.distances, b.distances, [](const auto& x, const auto& y) {
           return Same(x.distance_m, y.distance_m) && Same(x.gradient, y.gradient);
         });
}

}  // namespace splinemap
