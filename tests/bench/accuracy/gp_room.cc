#include "tests/bench/accuracy/gp_room.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <random>

#include "splinemap/surface.h"
#include "tests/bench/accuracy/gp_map.h"
#include "tests/bench/accuracy/rooms.h"
#include "tests/bench/accuracy/score.h"
#include "tests/bench/accuracy/table.h"

namespace splinemap {
namespace {

using Eigen::Vector2d;
using Scans = std::vector<std::vector<PlacedBeam>>;
using Function = std::function<double(const Vector2d&)>;

const Room kRoom = CircularRoom(2);

double Seconds(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Hits (8) and free samples (9) as the spline has them, `count` of them.
std::vector<LabelledPoint> SamplePoints(const Scans& scans, size_t count, std::mt19937_64& random) {
  constexpr double kSpacing_m = 0.141;
  std::vector<LabelledPoint> points;
  for (const std::vector<PlacedBeam>& scan : scans) {
    for (const PlacedBeam& beam : scan) {
      points.push_back({beam.range_m * beam.direction_world, 1});
      for (int j = 0; j < std::floor(beam.range_m / kSpacing_m); ++j) {
        points.push_back({j * kSpacing_m * beam.direction_world, -1});
      }
    }
  }
  std::shuffle(points.begin(), points.end(), random);
  points.resize(std::min(points.size(), count));
  return points;
}

GpParameters BestParameters(const std::vector<LabelledPoint>& points) {
  GpParameters best;
  double best_evidence = -std::numeric_limits<double>::infinity();
  for (const double length_m : {0.1, 0.2, 0.4, 0.8}) {
    for (const double noise_variance : {0.003, 0.03, 0.3}) {
      const double evidence = GpMap(points, {length_m, noise_variance}).Evidence();
      if (evidence < best_evidence) continue;
      best_evidence = evidence;
      best = {length_m, noise_variance};
    }
  }
  return best;
}

std::vector<double> Values(const std::vector<Vector2d>& points_m, const Function& function) {
  std::vector<double> values;
  for (const Vector2d& point_m : points_m) values.push_back(function(point_m));
  return values;
}

// Free points 0.1 to 0.3 m before the wall.
std::vector<Vector2d> FreeNearWall() {
  std::vector<Vector2d> points_m;
  for (const Vector2d& hit_m : TrueHits(kRoom)) {
    const double before_m = 0.1 + 0.2 * static_cast<double>(points_m.size() % 20) / 19;
    points_m.push_back(hit_m - before_m * hit_m.normalized());
  }
  return points_m;
}

// `scaled` gives -1 .. 1 as in (37), `log_odds` orders points by how occupied they are.
void WriteRow(Table& table, const std::string& name, int scans, double map_s,
              const Function& scaled, const Function& log_odds) {
  const std::vector<Vector2d> hits_m = TrueHits(kRoom);
  const std::vector<double> hits = Values(hits_m, log_odds);
  const std::vector<double> free = Values(FreeNearWall(), log_odds);
  std::vector<double> by_probability;
  for (const double s : hits) by_probability.push_back(2 * Probability(s) - 1);
  std::vector<double> at_hits;
  const double read_s = Seconds([&] { at_hits = Values(hits_m, scaled); });
  table.Row(name, scans, MappingError(at_hits), MappingError(by_probability), Auc(hits, free),
            MeanLogLikelihood(hits, free), map_s * 1e3,
            read_s / static_cast<double>(hits_m.size()) * 1e6);
}

void WriteGpRow(Table& table, const Scans& scans, const Effort& effort, std::mt19937_64& random) {
  const std::vector<LabelledPoint> points = SamplePoints(scans, effort.gp_points, random);
  const GpParameters parameters = BestParameters(points);
  std::unique_ptr<GpMap> map;
  const double map_s = Seconds([&] { map = std::make_unique<GpMap>(points, parameters); });
  WriteRow(
      table, fmt::format("GP {:.1f} m noise {}", parameters.length_m, parameters.noise_variance),
      static_cast<int>(scans.size()), map_s, [&](const Vector2d& p) { return map->Mean(p); },
      [&](const Vector2d& p) {
        const double occupied = map->Probability(p);
        return std::log(occupied / (1 - occupied));
      });
}

}  // namespace

void WriteGp(const std::vector<Method>& methods, const Effort& effort, const std::string& out) {
  Table table(out + "/gp.csv", {"method", "scans", "mapping_error", "mapping_error_of_p",
                                "auc_near", "log_likelihood_near", "map_ms", "read_us"});
  for (const int count : {4, effort.room_scans}) {
    std::mt19937_64 random(1);
    Scans scans;
    for (int n = 0; n < count; ++n) scans.push_back(ScanRoom(kRoom, 0.05, random));
    WriteGpRow(table, scans, effort, random);
    for (const Method& method : methods) {
      const std::unique_ptr<TestedMap> map = method.make(0.1);
      const double map_s = Seconds([&] {
        for (const std::vector<PlacedBeam>& scan : scans) map->AddScan(scan);
      });
      WriteRow(
          table, method.name, count, map_s, [&](const Vector2d& p) { return map->Scaled(p); },
          [&](const Vector2d& p) { return map->LogOdds(p); });
    }
  }
}

}  // namespace splinemap
