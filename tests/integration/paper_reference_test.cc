// The project's arithmetic against the paper's, on a recorded drive.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <unordered_map>
#include <vector>

#include "lib/map/map.h"
#include "lib/mapping/beam_model.h"
#include "lib/spline/basis.h"
#include "tests/support/recorded_drive.h"
#include "tests/support/shared_data.h"

namespace splinemap {
namespace {

constexpr double kKnot = 0.05;

// Update (36) per measurement, in double, over a plain hash map.
class PaperMap {
 public:
  void Add(const PlacedBeam& beam) {
    const double spacing_m = 1.41 * kKnot;
    Measure(beam.origin_world_m + beam.range_m * beam.direction_world, 0.9);
    for (int j = 0; j < std::floor(beam.range_m / spacing_m); ++j) {
      Measure(beam.origin_world_m + j * spacing_m * beam.direction_world, -0.3);
    }
  }

  double Evaluate(double x_m, double y_m) {
    double s = 0;
    Visit({x_m, y_m}, &Basis, [&](double& c, double weight) { s += c * weight; });
    return s;
  }

 private:
  void Measure(const Eigen::Vector2d& point_m, double kappa) {
    Visit(point_m, &NormalizedBasis,
          [&](double& c, double weight) { c = std::clamp(c + kappa * weight, -100.0, 100.0); });
  }

  template <typename Function>
  void Visit(const Eigen::Vector2d& p, BasisWeights (*weights)(double), Function function) {
    const KnotPosition x = *LocateKnot(p.x(), kKnot);
    const KnotPosition y = *LocateKnot(p.y(), kKnot);
    const BasisWeights wx = weights(x.t);
    const BasisWeights wy = weights(y.t);
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) {
        function(At(x.index - 1 + column, y.index - 1 + row), wx[column] * wy[row]);
      }
    }
  }

  double& At(int64_t i, int64_t j) { return control_points_[(i << 32) + j]; }

  std::unordered_map<int64_t, double> control_points_;
};

TEST(PaperReferenceTest, TheSurfaceOfIntelDiffersByLessThanFiveHundredthsRms) {
  const auto path = SharedData("carmen/intel-corrected.log.gz");
  if (!path) GTEST_SKIP() << "the shared data folder with recorded drives is not there";
  const auto drive = ReadRecordedDrive(*path, {});
  ASSERT_TRUE(drive.ok()) << drive.status();
  PaperMap paper;
  Map map({kKnot, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  BeamModel model({.free_space = FreeSpace::kSamples}, kKnot);
  ScanScratch scratch;
  for (const RecordedScan& scan : *drive) {
    const std::vector<PlacedBeam> beams = Place(scan);
    for (const PlacedBeam& beam : beams) paper.Add(beam);
    model.Accumulate(beams, scratch);
    scratch.CommitTo(layer, map.options().limits);
  }

  const auto snapshot = map.Snapshot();
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> offset_m(0, Tile::kSide * kKnot);
  double squares = 0;
  int64_t points = 0;
  snapshot->merged.ForEach([&](TileKey key, const TileTree::Entry&) {
    for (int n = 0; n < 3000; ++n) {
      const double x_m = key.tx * Tile::kSide * kKnot + offset_m(random);
      const double y_m = key.ty * Tile::kSide * kKnot + offset_m(random);
      const double error = snapshot->Evaluate(x_m, y_m).log_odds - paper.Evaluate(x_m, y_m);
      squares += error * error;
      ++points;
    }
  });
  const double rms = std::sqrt(squares / static_cast<double>(points));
  RecordProperty("rms_log_odds", std::to_string(rms));
  std::printf("rms %.4f log-odds over %ld points\n", rms, static_cast<long>(points));
  EXPECT_GT(points, 900'000);
  EXPECT_LE(rms, 0.05);
}

}  // namespace
}  // namespace splinemap
