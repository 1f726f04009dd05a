#include "tests/bench/serving/largest_requests.h"

#include <algorithm>
#include <chrono>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "fmt/format.h"
#include "lib/base/clock.h"
#include "lib/rpc/encoded.h"
#include "splinemap/local_map.h"
#include "tests/support/map_writer.h"

namespace splinemap::bench {
namespace {

constexpr double kKnotInterval_m = 0.05;
constexpr double kTile_m = Tile::kSide * kKnotInterval_m;
// Control points are random up to the clamps; the surface reaches this rarely, and everywhere it
// might: each cell has to be looked at closely.
constexpr double kOccupied = 8;

double Uniform(std::mt19937_64& random, double min, double max) {
  return std::uniform_real_distribution<double>(min, max)(random);
}

std::shared_ptr<const MapView> RuggedMap(int tiles) {
  std::mt19937_64 random(1);
  MapWriter map({kKnotInterval_m, {-2560, 2560}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int y = 0; y < tiles; ++y) {
    for (int x = 0; x < tiles; ++x) {
      for (ControlPoint& point : layer.EditTile({x, y}).control_points) {
        point = ClampTouched(static_cast<int32_t>(Uniform(random, -2560, 2560)), {-2560, 2560});
      }
    }
  }
  return map.View();
}

template <typename Query>
double Milliseconds(const LocalMap& map, const Query& query) {
  const auto begin = Clock::now();
  map.Ask(query).IgnoreError();
  return std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
}

// Of the whole query, by the mean of some pieces, and of the slowest of them.
template <typename Query>
Figures::Competitor Measure(const std::string& name, const LocalMap& map, const Query& query) {
  const std::vector<Chunk> pieces = Split(query);
  double sum_ms = 0;
  double most_ms = 0;
  int measured = 0;
  for (const Chunk& piece : pieces) {
    const auto asked = *DecodeRequest<Query>(EncodeRequest(query, piece, request_t()));
    if (!asked.ok()) continue;  // one sweep that is too large
    const double ms = Milliseconds(map, *asked);
    sum_ms += ms;
    most_ms = std::max(most_ms, ms);
    if (++measured == 5) break;
  }
  const double whole_ms = sum_ms / measured * static_cast<double>(pieces.size());
  return {fmt::format("{}, {} pieces", name, pieces.size()), {whole_ms, most_ms}};
}

}  // namespace

Figures MeasureLargestRequests(int tiles) {
  std::mt19937_64 random(2);
  const LocalMap map(RuggedMap(tiles));
  const double side_m = tiles * kTile_m;
  const auto point = [&] {
    return Eigen::Vector2d(Uniform(random, 0, side_m), Uniform(random, 0, side_m));
  };
  const auto points = [&](size_t size) {
    std::vector<Eigen::Vector2d> points_m(size);
    std::generate(points_m.begin(), points_m.end(), point);
    return points_m;
  };
  Figures figures{"largest requests, on a rugged map", {"ms the whole", "ms a request"}, {}};
  auto& rows = figures.competitors;
  // What queries need beside the map is made when one asks first.
  map.Ask(RaysQuery{{{point(), 0, 1}}}).IgnoreError();
  rows.push_back(Measure("2360 points", map, PointsQuery{points(2360), false}));
  rows.push_back(
      Measure("1204 points with second derivatives", map, PointsQuery{points(1204), true}));
  LikelihoodsQuery scan{.hits_robot_m = points(2000), .world_T_robot = {}};
  scan.world_T_robot.resize(250);
  rows.push_back(Measure("250 poses of 2000 hits", map, scan));
  RaysQuery rays{.rays = {}, .occupied_log_odds = kOccupied, .unknown = UnknownPolicy::kFree};
  for (int k = 0; k < 1843; ++k) rays.rays.push_back({point(), Uniform(random, -3, 3), 300});
  rows.push_back(Measure("1843 rays of 300 m", map, rays));
  for (const double radius_m : {0.0, 10.0}) {
    SweepsQuery sweeps{
        .sweeps = {}, .occupied_log_odds = kOccupied, .unknown = UnknownPolicy::kFree};
    for (int k = 0; k < 1340; ++k) sweeps.sweeps.push_back({{point(), point()}, radius_m});
    rows.push_back(Measure(fmt::format("1340 sweeps of {} m radius", radius_m), map, sweeps));
  }
  for (const double max_m : {2.0, 10.0, 100.0}) {
    const DistancesQuery distances{points(2458), max_m, kOccupied};
    rows.push_back(Measure(fmt::format("2458 distances within {} m", max_m), map, distances));
  }
  return figures;
}

}  // namespace splinemap::bench
