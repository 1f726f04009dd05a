#include "tests/bench/align/pieces.h"

#include <algorithm>

#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "tests/support/map_writer.h"
#include "tests/support/shared_data.h"

namespace splinemap {
namespace {

constexpr double kKnot_m = 0.05;

// The control points of `map` that are known, and those of them that `other` knows.
std::pair<int64_t, int64_t> CountKnown(const MapView& map, const MapView& other) {
  int64_t known = 0;
  int64_t shared = 0;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) {
    std::vector<Eigen::Vector2d> points_m;
    for (int k = 0; k < Tile::kSize; ++k) {
      points_m.emplace_back(kKnot_m * (Tile::kSide * key.tx + k % Tile::kSide),
                            kKnot_m * (Tile::kSide * key.ty + k / Tile::kSide));
    }
    std::vector<SurfaceSample> samples(points_m.size());
    map.EvaluateMany(points_m, absl::MakeSpan(samples));
    std::vector<SurfaceSample> others(points_m.size());
    other.EvaluateMany(points_m, absl::MakeSpan(others));
    for (size_t k = 0; k < samples.size(); ++k) {
      known += samples[k].known ? 1 : 0;
      shared += samples[k].known && others[k].known ? 1 : 0;
    }
  });
  return {known, shared};
}

}  // namespace

std::vector<NamedDrive> ReadBuildings() {
  std::vector<NamedDrive> drives;
  for (const char* name : {"intel", "freiburg-079", "csail", "aces", "belgioioso"}) {
    const auto path = SharedData(std::string("carmen/") + name + "-corrected.log.gz");
    if (!path) continue;
    auto scans = ReadRecordedDrive(*path, {});
    if (scans.ok()) drives.push_back({name, *std::move(scans)});
  }
  return drives;
}

std::shared_ptr<const MapView> MapOfPiece(const NamedDrive& drive, size_t first, size_t last,
                                          const Pose2& map_T_world) {
  BeamModel model({}, kKnot_m);
  ScanScratch scratch;
  MapWriter map({kKnot_m, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  for (size_t k = first; k < last; ++k) {
    RecordedScan scan = drive.scans[k];
    scan.world_T_sensor = map_T_world * scan.world_T_sensor;
    model.Accumulate(Place(scan), scratch);
    scratch.CommitTo(layer, map.options().limits);
  }
  return map.View();
}

Eigen::Vector2d MiddleOf(const NamedDrive& drive, size_t first, size_t last) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (size_t k = first; k < last; ++k) sum += drive.scans[k].world_T_sensor.position_m;
  return sum / static_cast<double>(last - first);
}

double SharedPart(const MapView& a, const MapView& b) {
  const auto [known_a, shared] = CountKnown(a, b);
  const int64_t known_b = CountKnown(b, b).first;
  return static_cast<double>(shared) / static_cast<double>(std::min(known_a, known_b));
}

}  // namespace splinemap
