#include "lib/mapping/beam_model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include "lib/spline/basis.h"
#include "splinemap/map_view.h"
#include "tests/support/map_writer.h"

namespace splinemap::beam_model_test {

constexpr double kKnot = 0.05;
constexpr BeamModelOptions kPaperLine{.update = BeamUpdate::kPaperLine};
constexpr BeamUpdate kAllUpdates[] = {BeamUpdate::kSignedDistance, BeamUpdate::kPaperLine,
                                      BeamUpdate::kPaperSamples};

PlacedBeam Beam(double x, double y, double bearing_rad, double range_m, bool hit = true) {
  return {{x, y}, {std::cos(bearing_rad), std::sin(bearing_rad)}, range_m, hit};
}

std::shared_ptr<const MapView> MapOf(const std::vector<PlacedBeam>& beams,
                                     BeamModelOptions options = {},
                                     const ScanKernel& kernel = FastestScanKernel()) {
  MapWriter map({kKnot, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  ScanScratch scratch(kernel);
  BeamModel(options, kKnot).Accumulate(beams, scratch);
  scratch.CommitTo(layer, map.options().limits);
  return map.View();
}

TEST(BeamModelTest, AHitRaisesTheSurfaceAtItsPointByKappa) {
  // Shorter than the first free sample that could reach the hit: (34) holds exactly but for
  // rounding.
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> coordinate(-3, 3);
  for (int n = 0; n < 200; ++n) {
    const double x = coordinate(random);
    const double y = coordinate(random);
    const auto map = MapOf({Beam(x, y, 0, 0.06)}, kPaperLine);
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

double ControlPointAt(const MapView& map, int i, int j) {
  const auto tile = FindTile(map.tiles, TileOf(i, j));
  return tile == nullptr ? 0 : tile->control_points[IndexInTile(i, j)] / double{kUnitsPerLogOdds};
}

TEST(BeamModelTest, OneScanEqualsThePapersSumsToTheLastUnits) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> range(0.05, 12);
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < 360; ++k) {
    beams.push_back(Beam(-1.23, 0.77, k * 0.01745, range(random), k % 5 != 0));
  }
  const auto map = MapOf(beams, {.update = BeamUpdate::kPaperSamples});
  for (const auto& [index, sum] : PaperSums(beams)) {
    const double c = ControlPointAt(*map, index.first, index.second);
    // The phase of each sample is rounded to 1/256 knot; near the sensor hundreds add up.
    const double expected = std::clamp(sum, -100.0, 100.0);
    EXPECT_NEAR(c, expected, 0.012 + 0.004 * std::abs(expected));
  }
}

// Samples (9) with the phase as the unknown that it is: the mean over phases of what samples add.
TEST(BeamModelTest, TheLineIntegralIsTheMeanOfSamplesOverTheirPhase) {
  const double spacing_m = 1.41 * kKnot;
  constexpr int kPhases = 50;
  constexpr int kBeams = 64;
  for (int n = 0; n < kBeams; ++n) {
    // Many times the same beam, so that rounding to units of control points does not count.
    const double bearing_rad = 0.3 + n * 0.0981;
    const PlacedBeam beam = Beam(0.513, -0.721, bearing_rad, 3, false);
    const std::vector<PlacedBeam> beams(100, beam);
    std::vector<PlacedBeam> shifted;
    for (int phase = 0; phase < kPhases; ++phase) {
      const double start_m = (phase + 0.5) / kPhases * spacing_m;
      shifted.push_back(beam);
      shifted.back().origin_world_m += start_m * beam.direction_world;
      shifted.back().range_m -= start_m;
    }
    const auto expected = PaperSums(shifted);
    const auto map = MapOf(beams, kPaperLine);
    double total = 0;
    double expected_total = 0;
    for (const auto& [index, sum] : expected) {
      const double mean = sum / kPhases;
      const double c = ControlPointAt(*map, index.first, index.second) / 100;
      total += c;
      expected_total += mean;
      // Columns and slopes are rounded. Within two knots of its ends the line is cut at a row.
      const Eigen::Vector2d knot = Eigen::Vector2d(index.first, index.second) * kKnot;
      const double along_m = (knot - beam.origin_world_m).dot(beam.direction_world);
      if (along_m < 4 * kKnot || along_m > 3 - 6 * kKnot) continue;
      EXPECT_NEAR(c, mean, 0.02) << n << ": " << index.first << ", " << index.second;
    }
    EXPECT_NEAR(total / expected_total, 1, 0.02) << n;
  }
}

std::vector<PlacedBeam> RandomBeams(int count) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < count; ++k) {
    // Also straight along the axes, across the origin, short and long.
    const double bearing_rad = k % 10 == 0 ? k / 10 * std::acos(0.0) : 6.3 * uniform(random);
    const double range_m = k % 3 == 0 ? 0.3 * uniform(random) : 25 * uniform(random);
    beams.push_back(
        Beam(4 * uniform(random) - 2, 4 * uniform(random) - 2, bearing_rad, range_m, k % 4 != 0));
  }
  return beams;
}

void ExpectEqual(const MapView& a, const MapView& b) {
  ASSERT_EQ(a.tiles.size(), b.tiles.size());
  a.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const auto other = FindTile(b.tiles, key);
    ASSERT_NE(other, nullptr);
    EXPECT_EQ(*entry.tile->Get(), *other);
  });
}

TEST(BeamModelTest, EveryKernelMakesTheBytesOfThePlainOne) {
  const std::vector<PlacedBeam> beams = RandomBeams(2000);
  for (const BeamUpdate update : kAllUpdates) {
    const BeamModelOptions options{.update = update};
    const auto plain = MapOf(beams, options, ScanKernels().front());
    EXPECT_GT(plain->tiles.size(), 500u);
    for (const ScanKernel& kernel : ScanKernels()) {
      SCOPED_TRACE(kernel.name);
      ExpectEqual(*plain, *MapOf(beams, options, kernel));
    }
  }
}

// Of later scans control points move a part of the way, which is rounded.
TEST(BeamModelTest, EveryKernelMakesTheBytesOfThePlainOneScanAfterScan) {
  const std::vector<PlacedBeam> beams = RandomBeams(2000);
  const auto map_of = [&](const ScanKernel& kernel) {
    MapWriter map({kKnot, {}});
    Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
    ScanScratch scratch(kernel);
    for (size_t first = 0; first < beams.size(); first += 500) {
      BeamModel({}, kKnot, kernel).Accumulate({&beams[first], 500}, scratch);
      scratch.CommitTo(layer, map.options().limits);
    }
    return map.View();
  };
  const auto plain = map_of(ScanKernels().front());
  for (const ScanKernel& kernel : ScanKernels()) {
    SCOPED_TRACE(kernel.name);
    ExpectEqual(*plain, *map_of(kernel));
  }
}

// Beams so close to each other that weights of free space saturate, as far as a face beside them.
TEST(BeamModelTest, EveryKernelMakesTheBytesOfThePlainOneWhereWeightsSaturate) {
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < 4000; ++k) {
    const double bearing_rad = 0.1 + 0.0003 * k;
    beams.push_back(Beam(0.012, 0.013, bearing_rad, k < 2000 ? 0.25 : 2));
  }
  const auto plain = MapOf(beams, {}, ScanKernels().front());
  for (const ScanKernel& kernel : ScanKernels()) {
    SCOPED_TRACE(kernel.name);
    ExpectEqual(*plain, *MapOf(beams, {}, kernel));
  }
}

TEST(BeamModelTest, ABeamWithoutHitOnlyClears) {
  for (const BeamUpdate update : kAllUpdates) {
    const auto map = MapOf({Beam(0, 0, 0.3, 5, false)}, {.update = update});
    map->tiles.ForEach([](TileKey, const TileTree::Entry& entry) {
      const auto tile = entry.tile->Get();
      for (const ControlPoint c : tile->control_points) EXPECT_LE(c, 0);
    });
    EXPECT_LT(map->Evaluate(2 * std::cos(0.3), 2 * std::sin(0.3)).log_odds, -0.2);
  }
}

TEST(BeamModelTest, TheOrderOfBeamsDoesNotMatterToThePapersUpdate) {
  std::mt19937_64 random(6);
  std::vector<PlacedBeam> beams = RandomBeams(200);
  const auto first = MapOf(beams, kPaperLine);
  std::shuffle(beams.begin(), beams.end(), random);
  ExpectEqual(*first, *MapOf(beams, kPaperLine));
}

// The bound that ScanScratch states: the most beams with the strongest options through one point.
TEST(BeamModelTest, TheHeaviestScanDoesNotOverflow) {
  const BeamModelOptions strongest{.update = BeamUpdate::kPaperLine,
                                   .kappa_hit = kMaxKappaHit,
                                   .kappa_free = kMinKappaFree,
                                   .free_sample_spacing_knots = kMinFreeSampleSpacingKnots};
  const std::vector<PlacedBeam> hits(kMaxBeams, Beam(0.01, 0, 0, 0.04));  // no free sample
  EXPECT_GT(MapOf(hits, strongest)->Evaluate(0.05, 0).log_odds, 99);
  const std::vector<PlacedBeam> free(kMaxBeams, Beam(0, 0, 0.6, 1, false));
  for (const BeamUpdate update : {BeamUpdate::kPaperLine, BeamUpdate::kPaperSamples}) {
    BeamModelOptions options = strongest;
    options.update = update;
    const auto map = MapOf(free, options);
    EXPECT_LT(map->Evaluate(0.3 * std::cos(0.6), 0.3 * std::sin(0.6)).log_odds, -99);
  }
}

TEST(BeamModelTest, TheHeaviestWeightsDoNotOverflow) {
  // A narrow thing weighs most: one beam further to either side.
  std::vector<PlacedBeam> beams(kMaxBeams, Beam(0, 0, 0.6, 1));
  beams.front() = Beam(0, 0, 0.5, 3);
  beams.back() = Beam(0, 0, 0.7, 3);
  const auto map = MapOf(beams);
  for (const double range_m : {0.3, 0.8}) {
    EXPECT_LT(map->Evaluate(range_m * std::cos(0.6), range_m * std::sin(0.6)).log_odds, -4);
  }
  EXPECT_GT(map->Evaluate(1.02 * std::cos(0.6), 1.02 * std::sin(0.6)).log_odds, 0);
}

}  // namespace splinemap::beam_model_test
