// The project's arithmetic against the paper's, on a recorded drive.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "lib/mapping/beam_model.h"
#include "splinemap/map_view.h"
#include "tests/support/map_writer.h"
#include "tests/support/paper_map.h"
#include "tests/support/recorded_drive.h"
#include "tests/support/shared_data.h"

namespace splinemap::paper_reference_test {

constexpr double kKnot = 0.05;

TEST(PaperReferenceTest, TheSurfaceOfIntelDiffersByLessThanFiveHundredthsRms) {
  const auto path = SharedData("carmen/intel-corrected.log.gz");
  if (!path) GTEST_SKIP() << "the shared data folder with recorded drives is not there";
  const auto drive = ReadRecordedDrive(*path, {});
  ASSERT_TRUE(drive.ok()) << drive.status();
  PaperMap paper(kKnot);
  MapWriter map({kKnot, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  BeamModel model({.update = BeamUpdate::kPaperSamples}, kKnot);
  ScanScratch scratch;
  for (const RecordedScan& scan : *drive) {
    const std::vector<PlacedBeam> beams = Place(scan);
    for (const PlacedBeam& beam : beams) paper.Add(beam);
    model.Accumulate(beams, scratch);
    scratch.CommitTo(layer, map.options().limits);
  }

  const auto view = map.View();
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> offset_m(0, Tile::kSide * kKnot);
  double squares = 0;
  int64_t points = 0;
  view->tiles.ForEach([&](TileKey key, const TileTree::Entry&) {
    for (int n = 0; n < 3000; ++n) {
      const double x_m = key.tx * Tile::kSide * kKnot + offset_m(random);
      const double y_m = key.ty * Tile::kSide * kKnot + offset_m(random);
      const double error = view->Evaluate(x_m, y_m).log_odds - paper.Evaluate(x_m, y_m);
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

}  // namespace splinemap::paper_reference_test
