#include "lib/mapping/beam_model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include "lib/map/map.h"
#include "lib/spline/basis.h"

namespace splinemap {
namespace {

constexpr double kKnot = 0.05;

PlacedBeam Beam(double x, double y, double bearing_rad, double range_m, bool hit = true) {
  return {{x, y}, {std::cos(bearing_rad), std::sin(bearing_rad)}, range_m, hit};
}

std::shared_ptr<const MapSnapshot> MapOf(const std::vector<PlacedBeam>& beams,
                                         BeamModelOptions options = {}) {
  Map map({kKnot, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  ScanScratch scratch;
  BeamModel(options, kKnot).Accumulate(beams, scratch);
  scratch.CommitTo(layer, map.options().limits);
  return map.Snapshot();
}

TEST(BeamModelTest, AHitRaisesTheSurfaceAtItsPointByKappa) {
  // Shorter than the first free sample that could reach the hit: (34) holds exactly but for
  // rounding.
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> coordinate(-3, 3);
  for (int n = 0; n < 200; ++n) {
    const double x = coordinate(random);
    const double y = coordinate(random);
    const auto map = MapOf({Beam(x, y, 0, 0.06)});
    EXPECT_NEAR(map->Evaluate(x + 0.06, y).log_odds, 0.9, 0.015);
  }
}

// The paper's rule written down once more, in double and over a plain std::map.
std::map<std::pair<int, int>, double> PaperSums(const std::vector<PlacedBeam>& beams) {
  std::map<std::pair<int, int>, double> sums;
  const auto measure = [&](const Eigen::Vector2d& p, double kappa) {
    const KnotPosition x = *LocateKnot(p.x(), kKnot);
    const KnotPosition y = *LocateKnot(p.y(), kKnot);
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) {
        sums[{x.index - 1 + column, y.index - 1 + row}] +=
            kappa * NormalizedBasis(x.t)[column] * NormalizedBasis(y.t)[row];
      }
    }
  };
  for (const PlacedBeam& beam : beams) {
    if (beam.hit) measure(beam.origin_world_m + beam.range_m * beam.direction_world, 0.9);
    for (int j = 0; j <= std::floor(beam.range_m / (1.41 * kKnot)) - 1; ++j) {
      measure(beam.origin_world_m + j * 1.41 * kKnot * beam.direction_world, -0.3);
    }
  }
  return sums;
}

TEST(BeamModelTest, OneScanEqualsThePapersSumsToTheLastUnits) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> range(0.05, 12);
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < 360; ++k) {
    beams.push_back(Beam(-1.23, 0.77, k * 0.01745, range(random), k % 5 != 0));
  }
  const auto map = MapOf(beams);
  for (const auto& [index, sum] : PaperSums(beams)) {
    const TileTree::Entry* entry = map->merged.Find(TileOf(index.first, index.second));
    const double c = entry == nullptr
                         ? 0
                         : entry->tile->control_points[IndexInTile(index.first, index.second)] /
                               double{kUnitsPerLogOdds};
    // The phase of each sample is rounded to 1/256 knot; near the sensor hundreds add up.
    const double expected = std::clamp(sum, -100.0, 100.0);
    EXPECT_NEAR(c, expected, 0.012 + 0.004 * std::abs(expected));
  }
}

TEST(BeamModelTest, ABeamWithoutHitOnlyClears) {
  const auto map = MapOf({Beam(0, 0, 0.3, 5, false)});
  map->merged.ForEach([](TileKey, const TileTree::Entry& entry) {
    for (const ControlPoint c : entry.tile->control_points) EXPECT_LE(c, 0);
  });
  EXPECT_LT(map->Evaluate(2 * std::cos(0.3), 2 * std::sin(0.3)).log_odds, -0.2);
}

TEST(BeamModelTest, TheOrderOfBeamsDoesNotMatter) {
  std::mt19937_64 random(6);
  std::uniform_real_distribution<double> uniform(0, 6);
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < 200; ++k) {
    beams.push_back(Beam(uniform(random), uniform(random), uniform(random), uniform(random)));
  }
  const auto first = MapOf(beams);
  std::shuffle(beams.begin(), beams.end(), random);
  const auto second = MapOf(beams);
  ASSERT_EQ(first->merged.size(), second->merged.size());
  first->merged.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    EXPECT_EQ(*entry.tile, *second->merged.Find(key)->tile);
  });
}

// The bound that ScanScratch states: the most beams with the strongest options through one point.
TEST(BeamModelTest, TheHeaviestScanDoesNotOverflow) {
  const BeamModelOptions strongest{.kappa_hit = kMaxKappaHit,
                                   .kappa_free = kMinKappaFree,
                                   .free_sample_spacing_knots = kMinFreeSampleSpacingKnots};
  const std::vector<PlacedBeam> hits(kMaxBeams, Beam(0.01, 0, 0, 0.04));  // no free sample
  EXPECT_GT(MapOf(hits, strongest)->Evaluate(0.05, 0).log_odds, 99);
  const std::vector<PlacedBeam> free(kMaxBeams, Beam(0, 0, 0.6, 1, false));
  EXPECT_LT(MapOf(free, strongest)->Evaluate(0.3 * std::cos(0.6), 0.3 * std::sin(0.6)).log_odds,
            -99);
}

}  // namespace
}  // namespace splinemap
