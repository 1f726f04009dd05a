// map_bytes [LOG..]: maps simulated drives and recorded ones, and prints a hash of all tiles of
// each and of each kind of answer. Processors that print the same have the same bytes.
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "fmt/format.h"
#include "lib/geometry/angle.h"
#include "lib/map/point_kernel.h"
#include "lib/mapping/scan_folder.h"
#include "lib/tiles/sum_kernel.h"
#include "splinemap/local_map.h"
#include "tests/support/map_writer.h"
#include "tests/support/queries.h"
#include "tests/support/random_map.h"
#include "tests/support/recorded_drive.h"

namespace splinemap {
namespace {

// Of numbers one after the other, so that no padding is among them.
class Hash {
 public:
  template <typename Number>
  void Add(Number number) {
    bytes_.append(reinterpret_cast<const char*>(&number), sizeof(number));
  }
  void Add(const Eigen::Vector2d& v) {
    Add(v.x());
    Add(v.y());
  }
  void Print(const std::string& what) {
    fmt::print("{:016x} {}\n", XXH3_64bits(bytes_.data(), bytes_.size()), what);
    bytes_.clear();
  }

 private:
  std::string bytes_;
};

void Add(const TileTree& tiles, Hash& hash) {
  tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    hash.Add(key.tx);
    hash.Add(key.ty);
    for (const ControlPoint c : entry.tile->Get()->control_points) hash.Add(c);
  });
}

// A robot goes round a pillar in a room of 6 x 4 m, with a scanner of 360 beams and 1 cm of noise.
// The C library's sine and cosine are not the same everywhere, and not used.
std::vector<PosedScan> DriveInRoom() {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> noise_m(-0.01, 0.01);
  std::vector<PosedScan> scans;
  for (int n = 0; n < 200; ++n) {
    const Eigen::Vector2d along = UnitVector(0.05 * n);
    const Pose2 pose{{2 * along.x(), 1.2 * along.y()}, 0.07 * n};
    PosedScan& scan = scans.emplace_back();
    scan.utime = Utime(100'000 * n);
    scan.world_T_robot = FixedPose2::Nearest(pose);
    scan.robot_T_sensor = {FixedPose2()};
    for (int k = 0; k < 360; ++k) {
      const double bearing_rad = k * M_PI / 180;
      const Eigen::Vector2d d = UnitVector(pose.yaw_rad + bearing_rad);
      double range_m = std::min(((d.x() > 0 ? 3 : -3) - pose.position_m.x()) / d.x(),
                                ((d.y() > 0 ? 2 : -2) - pose.position_m.y()) / d.y());
      const double to_pillar = -pose.position_m.x() * d.x() - pose.position_m.y() * d.y();
      const double aside = pose.position_m.x() * d.y() - pose.position_m.y() * d.x();
      const double chord = 0.3 * 0.3 - aside * aside;
      if (to_pillar > 0 && chord > 0) range_m = to_pillar - std::sqrt(chord);
      Beam& beam = scan.beams.emplace_back();
      beam.reading = static_cast<uint16_t>(k);
      beam.bearing_rad = static_cast<float>(bearing_rad);
      beam.range_m = static_cast<float>(range_m + noise_m(random));
      beam.hit = k % 50 != 0;
    }
  }
  return scans;
}

std::vector<PosedScan> RandomDrive() {
  std::mt19937_64 random(2);
  std::vector<PosedScan> scans;
  for (int n = 0; n < 500; ++n) scans.push_back(RandomScan(random, 5));
  return scans;
}

std::vector<PosedScan> RecordedDrive(const std::string& path) {
  const auto drive = ReadRecordedDrive(path, {});
  if (!drive.ok()) {
    fmt::print(stderr, "{}: {}\n", path, drive.status().ToString());
    std::exit(1);
  }
  std::vector<PosedScan> scans;
  for (const RecordedScan& recorded : *drive) scans.push_back(PosedScanOf(recorded));
  return scans;
}

// Two layers, of which the second has every third scan.
LayerSet LayersOf(const std::vector<PosedScan>& scans, double knot_interval_m,
                  const BeamModelOptions& model) {
  MapWriter map({knot_interval_m, {}});
  ScanFolder folder(map.options());
  PlacedScan placed;
  for (const size_t step : {1, 3}) {
    Layer& layer = map.AddLayer({"robot", step}, {1, 1});
    for (size_t n = 0; n < scans.size(); n += step) {
      Place(scans[n], {}, placed);
      if (folder.Check(placed).ok()) folder.Fold(placed, model, layer);
    }
  }
  return map.Layers();
}

void PrintAnswers(const std::string& name, std::shared_ptr<const MapView> view) {
  constexpr size_t kQueries = 2001;  // odd: with second derivatives
  const LocalMap map(std::move(view));
  std::mt19937_64 random(3);
  Hash hash;
  const PointsQuery::Answer points = *map.Ask(RandomPoints(random, kQueries));
  for (const SurfaceSample& sample : points.samples) {
    hash.Add(sample.log_odds);
    hash.Add(sample.gradient_per_m);
    hash.Add(sample.known);
  }
  hash.Print(name + "points");
  for (const Eigen::Matrix2d& hessian : points.hessians_per_m2) {
    for (int k = 0; k < 4; ++k) hash.Add(hessian.data()[k]);
  }
  hash.Print(name + "second derivatives");
  const RaysQuery::Answer rays = *map.Ask(RandomRays(random, kQueries));
  for (const RaysQuery::End& end : rays.ends) {
    hash.Add(end.occupancy);
    hash.Add(end.range_m);
  }
  hash.Print(name + "rays");
  const SweepsQuery::Answer sweeps = *map.Ask(RandomSweeps(random, kQueries));
  for (const SweepsQuery::Result& result : sweeps.results) {
    hash.Add(result.occupancy);
    hash.Add(result.is_certified);
    hash.Add(result.free_m);
    hash.Add(result.contact_m);
  }
  hash.Print(name + "sweeps");
  const RasterQuery::Answer raster = *map.Ask(RandomRaster(random, 100'000));
  for (const int16_t cell : raster.cells) hash.Add(cell);
  hash.Print(name + "raster");
  const DistancesQuery::Answer distances = *map.Ask(RandomDistances(random, kQueries));
  for (const DistancesQuery::Distance& distance : distances.distances) {
    hash.Add(distance.distance_m);
    hash.Add(distance.gradient);
  }
  hash.Print(name + "distances");
  const LikelihoodsQuery::Answer likelihoods = *map.Ask(RandomLikelihoods(random, 200));
  for (const double sum : likelihoods.log_likelihoods) hash.Add(sum);
  hash.Print(name + "likelihoods");
}

void PrintDrive(const std::string& drive, const std::vector<PosedScan>& scans) {
  constexpr std::pair<BeamUpdate, const char*> kUpdates[] = {
      {BeamUpdate::kSignedDistance, "signed distance"},
      {BeamUpdate::kPaperLine, "paper line"},
      {BeamUpdate::kPaperSamples, "paper samples"}};
  for (const auto& [update, update_name] : kUpdates) {
    const std::string name = fmt::format("{}, {}: ", drive, update_name);
    const LayerSet set = LayersOf(scans, 0.05, {.update = update});
    Hash hash;
    for (const LayerSnapshot& layer : set.layers) Add(layer.tiles, hash);
    hash.Print(name + "layers");
    const std::shared_ptr<const MapView> view = ViewOf(set);
    Add(view->tiles, hash);
    hash.Print(name + "their sum");
    PrintAnswers(name, view);
  }
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  using namespace splinemap;
  fmt::print(stderr, "map_bytes: {}, {}, {}\n", FastestScanKernel().name, FastestPointKernel().name,
             SumKernels().back().name);
  PrintDrive("room", DriveInRoom());
  PrintDrive("random", RandomDrive());
  for (int k = 1; k < argc; ++k) {
    PrintDrive(std::filesystem::path(argv[k]).filename(), RecordedDrive(argv[k]));
  }
}
