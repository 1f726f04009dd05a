#include "tests/bench/accuracy/drives.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "tests/bench/accuracy/score.h"
#include "tests/bench/accuracy/table.h"
#include "tests/support/recorded_drive.h"
#include "tests/support/shared_data.h"

namespace splinemap {
namespace {

std::vector<std::vector<PlacedBeam>> EveryOther(const std::vector<RecordedScan>& scans,
                                                size_t first) {
  std::vector<std::vector<PlacedBeam>> result;
  for (size_t k = first; k < scans.size(); k += 2) result.push_back(Place(scans[k]));
  return result;
}

void AddTestPoints(const std::vector<std::vector<PlacedBeam>>& scans, JudgedDrive& drive) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> share(0, 1);
  for (const std::vector<PlacedBeam>& beams : scans) {
    for (size_t k = 0; k < beams.size(); k += 4) {
      const PlacedBeam& beam = beams[k];
      const auto point = [&](double range_m) -> Eigen::Vector2d {
        return beam.origin_world_m + range_m * beam.direction_world;
      };
      if (beam.range_m < kNear_m) continue;
      drive.hits.push_back(point(beam.range_m));
      drive.free.push_back(point(share(random) * (beam.range_m - kMargin_m)));
      drive.free_near.push_back(
          point(beam.range_m - kNear_m + share(random) * (kNear_m - kMargin_m)));
    }
  }
}

std::vector<RecordedScan> Read(const std::string& path, bool no_return_is_free,
                               const Effort& effort) {
  SensorOptions options;
  options.no_return_is_free = no_return_is_free;
  absl::StatusOr<std::vector<RecordedScan>> scans = ReadRecordedDrive(path, options);
  if (!scans.ok()) {
    fmt::print("{}: {}\n", path, scans.status().ToString());
    return {};
  }
  scans->resize(std::min<size_t>(scans->size(), effort.max_log_scans));
  return *std::move(scans);
}

std::vector<double> LogOdds(const LogOddsAt& log_odds_at,
                            const std::vector<Eigen::Vector2d>& points_m) {
  std::vector<double> values;
  values.reserve(points_m.size());
  for (const Eigen::Vector2d& point_m : points_m) values.push_back(log_odds_at(point_m));
  return values;
}

// From the point to the nearest one on the other side of the level, to 5 mm; kFarthest_m where none
// is nearer.
constexpr double kFarthest_m = 0.3;
double DistanceToLevel(TestedMap& map, double level, const Eigen::Vector2d& point_m) {
  constexpr int kDirections = 24;
  const bool is_occupied = map.LogOdds(point_m) > level;
  for (double distance_m = 0.005; distance_m < kFarthest_m; distance_m += 0.005) {
    for (int k = 0; k < kDirections; ++k) {
      const double bearing_rad = 2 * std::numbers::pi * k / kDirections;
      const Eigen::Vector2d at =
          point_m + distance_m * Eigen::Vector2d(std::cos(bearing_rad), std::sin(bearing_rad));
      if ((map.LogOdds(at) > level) != is_occupied) return distance_m;
    }
  }
  return kFarthest_m;
}

}  // namespace

void WriteHits(const std::vector<Method>& methods, const std::vector<JudgedDrive>& drives,
               const std::string& out) {
  Table table(out + "/hits.csv", {"drive", "method", "median_mm", "ninety_percent_mm"});
  for (const JudgedDrive& drive : drives) {
    for (const Method& method : methods) {
      const std::unique_ptr<TestedMap> map = MapDrive(method, drive, 0.05);
      std::vector<double> distances_mm;
      const size_t step = std::max<size_t>(1, drive.hits.size() / 4000);
      for (size_t k = 0; k < drive.hits.size(); k += step) {
        distances_mm.push_back(1000 * DistanceToLevel(*map, method.level, drive.hits[k]));
      }
      table.Row(drive.name, method.name, Quantile(distances_mm, 0.5), Quantile(distances_mm, 0.9));
    }
  }
}

std::vector<JudgedDrive> ReadDrives(const Effort& effort) {
  std::vector<std::string> names = {"intel", "freiburg-079", "csail", "aces"};
  names.resize(effort.drives);
  std::vector<JudgedDrive> drives;
  for (const std::string& name : names) {
    const auto path = SharedData("carmen/" + name + "-corrected.log.gz");
    if (!path) {
      fmt::print("{}: skipped, the shared data folder with recorded drives is not there\n", name);
      continue;
    }
    const std::vector<RecordedScan> scans = Read(*path, false, effort);
    JudgedDrive drive;
    drive.name = name;
    drive.no_return_ignored = EveryOther(scans, 0);
    drive.no_return_free = EveryOther(Read(*path, true, effort), 0);
    AddTestPoints(EveryOther(scans, 1), drive);
    drives.push_back(std::move(drive));
  }
  return drives;
}

std::unique_ptr<TestedMap> MapDrive(const Method& method, const JudgedDrive& drive,
                                    double resolution_m) {
  std::unique_ptr<TestedMap> map = method.make(resolution_m);
  const auto& scans = method.no_return_is_free ? drive.no_return_free : drive.no_return_ignored;
  for (const std::vector<PlacedBeam>& beams : scans) map->AddScan(beams);
  return map;
}

Judgement Judge(TestedMap& map, const JudgedDrive& drive) {
  return Judge([&](const Eigen::Vector2d& point_m) { return map.LogOdds(point_m); }, drive);
}

Judgement Judge(const LogOddsAt& log_odds_at, const JudgedDrive& drive) {
  const std::vector<double> hits = LogOdds(log_odds_at, drive.hits);
  const std::vector<double> free = LogOdds(log_odds_at, drive.free);
  return {Auc(hits, free), Auc(hits, LogOdds(log_odds_at, drive.free_near)),
          MeanLogLikelihood(hits, free)};
}

void WriteLogs(const std::vector<Method>& methods, const std::vector<JudgedDrive>& drives,
               const std::string& out) {
  Table table(out + "/logs.csv",
              {"drive", "method", "resolution_m", "bytes", "auc", "auc_near", "log_likelihood"});
  for (const JudgedDrive& drive : drives) {
    for (const Method& method : methods) {
      for (const double resolution_m : {0.05, 0.075, 0.1, 0.15, 0.2}) {
        const std::unique_ptr<TestedMap> map = MapDrive(method, drive, resolution_m);
        const Judgement judgement = Judge(*map, drive);
        table.Row(drive.name, method.name, resolution_m, map->Bytes(), judgement.auc,
                  judgement.auc_near, judgement.log_likelihood);
      }
    }
  }
}

}  // namespace splinemap
