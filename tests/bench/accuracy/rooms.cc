#include "tests/bench/accuracy/rooms.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/bench/accuracy/score.h"
#include "tests/bench/accuracy/table.h"

namespace splinemap {
namespace {

constexpr double kResolution_m = 0.1;
constexpr int kBeams = 360;

double Bearing(int beam) { return beam * 2 * std::numbers::pi / kBeams; }

std::unique_ptr<TestedMap> MapRoom(const Method& method, const Room& room, double range_sigma_m,
                                   int scans, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::unique_ptr<TestedMap> map = method.make(kResolution_m);
  for (int n = 0; n < scans; ++n) map->AddScan(ScanRoom(room, range_sigma_m, random));
  return map;
}

void WriteMatrix(TestedMap& map, const std::string& path) {
  constexpr double kHalfSide_m = 2.4;
  constexpr int kPixels = 240;
  constexpr double kStep_m = 2 * kHalfSide_m / kPixels;
  std::ofstream file(path);
  for (int row = 0; row < kPixels; ++row) {
    for (int column = 0; column < kPixels; ++column) {
      const Eigen::Vector2d point_m((column + 0.5) * kStep_m - kHalfSide_m,
                                    (row + 0.5) * kStep_m - kHalfSide_m);
      file << fmt::format("{:.3f}{}", map.Scaled(point_m), column + 1 < kPixels ? ',' : '\n');
    }
  }
}

}  // namespace

Room SquareRoom(double half_side_m) {
  return [=](double bearing_rad) {
    return half_side_m / std::max(std::abs(std::cos(bearing_rad)), std::abs(std::sin(bearing_rad)));
  };
}

Room CircularRoom(double radius_m) {
  return [=](double) { return radius_m; };
}

std::vector<PlacedBeam> ScanRoom(const Room& room, double range_sigma_m, std::mt19937_64& random) {
  std::normal_distribution<double> noise(0, 1);
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < kBeams; ++k) {
    const double bearing_rad = Bearing(k);
    beams.push_back({Eigen::Vector2d::Zero(),
                     {std::cos(bearing_rad), std::sin(bearing_rad)},
                     room(bearing_rad) + range_sigma_m * noise(random),
                     true});
  }
  return beams;
}

std::vector<Eigen::Vector2d> TrueHits(const Room& room) {
  std::mt19937_64 unused;
  std::vector<Eigen::Vector2d> hits;
  for (const PlacedBeam& beam : ScanRoom(room, 0, unused)) {
    hits.push_back(beam.range_m * beam.direction_world);
  }
  return hits;
}

double RoomError(const Method& method, const Room& room, double range_sigma_m, int scans,
                 uint64_t seed) {
  const std::unique_ptr<TestedMap> map = MapRoom(method, room, range_sigma_m, scans, seed);
  std::vector<double> scaled;
  for (const Eigen::Vector2d& hit : TrueHits(room)) scaled.push_back(map->Scaled(hit));
  return MappingError(scaled);
}

void WriteFig3(const std::vector<Method>& methods, const Effort& effort, const std::string& out) {
  Table table(out + "/fig3.csv", {"method", "half_side_m", "mapping_error"});
  for (const Method& method : methods) {
    for (const double half_side_m : kFig3HalfSides_m) {
      table.Row(method.name, half_side_m,
                RoomError(method, SquareRoom(half_side_m), 0, effort.room_scans, 1));
    }
  }
}

std::vector<double> CircleErrors(const Method& method, double range_sigma_m, int scans, int runs) {
  std::vector<double> errors;
  for (int run = 0; run < runs; ++run) {
    errors.push_back(RoomError(method, CircularRoom(2), range_sigma_m, scans, run));
  }
  return errors;
}

void WriteFig5(const std::vector<Method>& methods, const Effort& effort, const std::string& out) {
  Table table(out + "/fig5.csv",
              {"method", "range_sigma_m", "least", "quartile", "median", "quartile3", "greatest"});
  for (const Method& method : methods) {
    for (const double range_sigma_m : {0.025, 0.05, 0.075, 0.1}) {
      const std::vector<double> errors =
          CircleErrors(method, range_sigma_m, effort.room_scans, effort.runs);
      table.Row(method.name, range_sigma_m, Quantile(errors, 0), Quantile(errors, 0.25),
                Quantile(errors, 0.5), Quantile(errors, 0.75), Quantile(errors, 1));
    }
  }
}

void WriteMaps(const std::vector<Method>& methods, const Effort& effort, const std::string& out) {
  Table table(out + "/maps.csv", {"scene", "method", "file"});
  const std::vector<std::pair<std::string, Room>> scenes = {{"square", SquareRoom(2)},
                                                            {"circle", CircularRoom(2)}};
  for (const auto& [scene, room] : scenes) {
    for (size_t k = 0; k < methods.size(); ++k) {
      const std::string file = fmt::format("map_{}_{}.csv", scene, k);
      WriteMatrix(*MapRoom(methods[k], room, 0, effort.room_scans, 1), out + "/" + file);
      table.Row(scene, methods[k].name, file);
    }
  }
}

}  // namespace splinemap
