// Where the surface is 0, beside the true faces of things, and beside the formula in plain code.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <random>
#include <vector>

#include "lib/mapping/beam_model.h"
#include "lib/mapping/faces.h"
#include "splinemap/map_view.h"
#include "tests/support/map_writer.h"

namespace splinemap::signed_distance_test {

using Eigen::Vector2d;

constexpr double kKnot = 0.05;
constexpr double kRad = std::numbers::pi / 180;

// A layer that scans are mapped into.
class Mapping {
 public:
  void Add(const std::vector<PlacedBeam>& beams) {
    model_.Accumulate(beams, scratch_);
    scratch_.CommitTo(layer_, map_.options().limits);
  }
  std::shared_ptr<const MapView> View() { return map_.View(); }
  ControlPoint At(int i, int j) const {
    const auto tile = FindTile(layer_.tiles(), TileOf(i, j));
    return tile == nullptr ? 0 : tile->control_points[IndexInTile(i, j)];
  }
  const Layer& layer() const { return layer_; }

 private:
  MapWriter map_{{kKnot, {}}};
  Layer& layer_ = map_.AddLayer({"robot", 1}, {1, 1});
  BeamModel model_{{}, kKnot};
  ScanScratch scratch_;
};

// A full turn of beams within a room, from (0, 0): a wall at x = distance_m, turned by yaw_rad
// about (0, 0), and others too far to matter.
std::vector<PlacedBeam> ScanWall(double distance_m, double yaw_rad, double noise_sigma_m,
                                 std::mt19937_64& random, int count = 720) {
  std::normal_distribution<double> noise(0, 1);
  std::vector<PlacedBeam> beams;
  for (int k = 0; k < count; ++k) {
    const double bearing_rad = 360.0 / count * k * kRad;
    const double cosine = std::cos(bearing_rad - yaw_rad);
    const double range_m = std::min(cosine > 0.01 ? distance_m / cosine : 8.0, 8.0);
    beams.push_back({{0, 0},
                     {std::cos(bearing_rad), std::sin(bearing_rad)},
                     range_m + noise_sigma_m * noise(random),
                     true});
  }
  return beams;
}

// Where the surface is 0 along the wall's normal, from 0.2 m before to 0.2 m behind it; not a
// number where it is not.
double LevelAt(const MapView& map, const Vector2d& face_m, const Vector2d& normal) {
  const auto value = [&](double behind_m) {
    const Vector2d point_m = face_m + behind_m * normal;
    return map.Evaluate(point_m.x(), point_m.y()).log_odds;
  };
  for (double behind_m = -0.2; behind_m < 0.2; behind_m += 0.002) {
    if (value(behind_m) < 0 && value(behind_m + 0.002) >= 0) return behind_m + 0.001;
  }
  return std::nan("");
}

TEST(SignedDistanceTest, TheLevelLiesOnAWallWhateverItsPlaceAndIncidence) {
  std::mt19937_64 random(1);
  for (int place = 0; place < 10; ++place) {
    const double distance_m = 1.5 + 0.1 * kKnot * place;
    for (const double yaw_deg : {0.0, 25.0, 45.0}) {
      Mapping mapping;
      for (int n = 0; n < 20; ++n) mapping.Add(ScanWall(distance_m, yaw_deg * kRad, 0.01, random));
      const auto map = mapping.View();
      const Vector2d normal(std::cos(yaw_deg * kRad), std::sin(yaw_deg * kRad));
      const Vector2d along(-normal.y(), normal.x());
      for (const double incidence_deg : {0.0, 30.0, 60.0, 70.0}) {
        double sum_m = 0;
        double squares_m2 = 0;
        constexpr int kRays = 11;
        for (int k = 0; k < kRays; ++k) {
          const double aside_m = distance_m * std::tan(incidence_deg * kRad) + 0.013 * (k - 5);
          const double error_m = LevelAt(*map, distance_m * normal + aside_m * along, normal);
          sum_m += error_m / kRays;
          squares_m2 += error_m * error_m / kRays;
        }
        EXPECT_LT(std::abs(sum_m), 0.007) << distance_m << ' ' << yaw_deg << ' ' << incidence_deg;
        EXPECT_LT(std::sqrt(squares_m2), 0.01)
            << distance_m << ' ' << yaw_deg << ' ' << incidence_deg;
      }
    }
  }
}

TEST(SignedDistanceTest, OneScanIsEnough) {
  std::mt19937_64 random(1);
  Mapping mapping;
  mapping.Add(ScanWall(1.52, 0, 0, random));
  EXPECT_NEAR(LevelAt(*mapping.View(), {1.52, 0}, {1, 0}), 0, 0.005);
}

TEST(SignedDistanceTest, TheSumOfLayersHasTheSameLevel) {
  std::mt19937_64 random(1);
  MapWriter both({kKnot, {}});
  for (const double noise_m : {0.0, 0.02}) {
    Layer& layer = both.AddLayer({"robot", noise_m > 0 ? 1u : 2u}, {1, 1});
    BeamModel model({}, kKnot);
    ScanScratch scratch;
    for (int n = 0; n < 10; ++n) {
      model.Accumulate(ScanWall(1.52, 0, noise_m, random), scratch);
      scratch.CommitTo(layer, both.options().limits);
    }
  }
  EXPECT_NEAR(LevelAt(*both.View(), {1.52, 0}, {1, 0}), 0, 0.006);
}

// Of the end point model of LikelihoodsQuery: see there.
TEST(SignedDistanceTest, OneWallAloneFitsBestTooFarAndARoomWhereItIs) {
  std::mt19937_64 random(1);
  Mapping mapping;
  for (int n = 0; n < 20; ++n) mapping.Add(ScanWall(1.5, 0, 0.01, random));
  const auto map = mapping.View();
  const std::vector<PlacedBeam> scan = ScanWall(1.5, 0, 0.01, random);
  // Where along x the hits beyond x fit best.
  const auto best_m = [&](double least_x_m) {
    double best = 0;
    double greatest = -std::numeric_limits<double>::infinity();
    for (double moved_m = -0.1; moved_m <= 0.1; moved_m += 0.002) {
      double sum = 0;
      for (const PlacedBeam& beam : scan) {
        const Vector2d hit_m = beam.origin_world_m + beam.range_m * beam.direction_world;
        if (hit_m.x() < least_x_m) continue;
        sum += std::log(Probability(map->Evaluate(hit_m.x() + moved_m, hit_m.y()).log_odds));
      }
      if (sum > greatest) best = moved_m;
      greatest = std::max(greatest, sum);
    }
    return best;
  };
  EXPECT_NEAR(best_m(1.4), kKnot, 0.02);
  EXPECT_NEAR(best_m(-10), 0, 0.01);
}

TEST(SignedDistanceTest, AWallThatIsGoneIsForgotten) {
  std::mt19937_64 random(1);
  Mapping mapping;
  for (int n = 0; n < 100; ++n) mapping.Add(ScanWall(1.5, 0, 0.01, random));
  EXPECT_GT(mapping.View()->Evaluate(1.53, 0).log_odds, 0);
  int scans = 0;
  while (mapping.View()->Evaluate(1.53, 0).log_odds > 0 && scans < 50) {
    mapping.Add(ScanWall(3, 0, 0.01, random));
    ++scans;
  }
  EXPECT_LE(scans, 3);
}

TEST(SignedDistanceTest, WhatNoLongerChangesIsNoChange) {
  std::mt19937_64 random(1);
  Mapping mapping;
  const std::vector<PlacedBeam> beams = ScanWall(1.5, 0.2, 0, random);
  for (int n = 0; n < 200; ++n) mapping.Add(beams);
  const uint64_t before = mapping.layer().revision();
  mapping.Add(beams);
  mapping.layer().tiles().ForEach(
      [&](TileKey, const TileTree::Entry& entry) { EXPECT_LE(entry.revision, before); });
}

// The formula in double, over a plain map and with integrals by samples.
struct Vote {
  double weight = 0;
  double occupied = 0;
};

double Hat(double x) { return std::max(0.0, 1 - std::abs(x)); }
double CubicBSpline(double x) {
  const double u = std::abs(x);
  if (u < 1) return (4 - 6 * u * u + 3 * u * u * u) / 6;
  return u < 2 ? (2 - u) * (2 - u) * (2 - u) / 6 : 0;
}

std::map<std::pair<int, int>, Vote> PlainVotes(const std::vector<PlacedBeam>& beams) {
  FaceFinder finder(1 / kKnot);
  const absl::Span<const Face> faces = finder.Find(beams);
  std::map<std::pair<int, int>, Vote> votes;
  for (size_t n = 0; n < beams.size(); ++n) {
    const Face& face = faces[n];
    const Vector2d direction = beams[n].direction_world;
    const bool is_steep = std::abs(direction.y()) >= std::abs(direction.x());
    const int axis = is_steep ? 1 : 0;
    const Vector2d origin = beams[n].origin_world_m / kKnot;
    const double range = beams[n].range_m / kKnot;
    const Vector2d hit = origin + range * direction;
    const double cut = origin[axis] + std::max(range - face.before_knots, 0.0) * direction[axis];
    const double end = origin[axis] + (range + face.behind_knots) * direction[axis];
    const double sign = direction[axis] > 0 ? 1 : -1;
    // Rows of control points between the origin and the end.
    for (int row = static_cast<int>(std::floor(std::min(origin[axis], end))) + 1;
         row <= static_cast<int>(std::floor(std::max(origin[axis], end))); ++row) {
      const bool is_face = sign > 0 ? row > std::floor(cut) : row <= std::floor(cut);
      const double across =
          origin[1 - axis] + (row - origin[axis]) * direction[1 - axis] / direction[axis];
      for (int column = static_cast<int>(std::floor(across)) - 4;
           column <= static_cast<int>(std::floor(across)) + 4; ++column) {
        double integral = 0;
        constexpr int kSteps = 32;
        for (int step = 0; step < kSteps; ++step) {
          const double v = -2 + (step + 0.5) * 4 / kSteps;
          const double x = across + v * direction[1 - axis] / direction[axis];
          const double both =
              is_face ? Hat(v) * Hat(x - column) : CubicBSpline(v) * CubicBSpline(x - column);
          integral += both * 4 / kSteps / std::abs(direction[axis]);
        }
        if (integral < 1e-9) continue;
        const Vector2d point = is_steep ? Vector2d(column, row) : Vector2d(row, column);
        const double behind = (point - hit).dot(Vector2d(face.normal[0], face.normal[1]));
        const double share =
            std::clamp((behind + SignedDistance::kFrontKnots) /
                           (SignedDistance::kFrontKnots + SignedDistance::kBackKnots),
                       0.0, 1.0);
        Vote& vote = votes[{static_cast<int>(point.x()), static_cast<int>(point.y())}];
        const double left = (end - row) / (face.behind_knots * direction[axis]);
        const double part = left < 1 ? std::floor(32 * left * left) / 32 : 1;
        const double weight = integral * (is_face ? face.weight * part : 1);
        vote.weight += weight;
        if (is_face) vote.occupied += weight * share;
      }
    }
  }
  return votes;
}

TEST(SignedDistanceTest, OneScanIsThePlainFormula) {
  std::mt19937_64 random(4);
  Mapping mapping;
  std::vector<PlacedBeam> beams = ScanWall(1.234, 0.3, 0.02, random, 180);
  beams[17].range_m = 0.7;  // a lone hit
  mapping.Add(beams);
  // Slopes and phases are rounded, and so are weights.
  int compared = 0;
  int different = 0;
  double sum = 0;
  for (const auto& [index, vote] : PlainVotes(beams)) {
    if (vote.weight < 0.05) continue;
    const double target =
        SignedDistance::kFree +
        (SignedDistance::kOccupied - SignedDistance::kFree) * vote.occupied / vote.weight;
    const double difference = mapping.At(index.first, index.second) - target;
    EXPECT_LT(std::abs(difference), kUnitsPerLogOdds) << index.first << ", " << index.second;
    different += std::abs(difference) > 0.1 * kUnitsPerLogOdds ? 1 : 0;
    sum += difference;
    ++compared;
  }
  EXPECT_GT(compared, 5000);
  EXPECT_LT(different, 0.01 * compared);
  EXPECT_NEAR(sum / compared, 0, 0.005 * kUnitsPerLogOdds);
}

TEST(SignedDistanceTest, LaterScansAreAveraged) {
  std::mt19937_64 random(4);
  Mapping mapping;
  mapping.Add(ScanWall(1.2, 0, 0, random, 180));
  const std::vector<PlacedBeam> beams = ScanWall(1.25, 0, 0, random, 180);
  std::map<std::pair<int, int>, Vote> votes = PlainVotes(beams);
  std::map<std::pair<int, int>, int> before;
  for (const auto& [index, vote] : votes) before[index] = mapping.At(index.first, index.second);
  mapping.Add(beams);
  int compared = 0;
  for (const auto& [index, vote] : votes) {
    if (before[index] == 0 || vote.weight < 0.2) continue;
    const double target =
        SignedDistance::kFree +
        (SignedDistance::kOccupied - SignedDistance::kFree) * vote.occupied / vote.weight;
    const double weight = std::min<double>(vote.weight * SignedDistance::kWeightPerKnot,
                                           SignedDistance::kMostWeight) /
                          (1 << SignedDistance::kForgetBits);
    EXPECT_NEAR(mapping.At(index.first, index.second),
                before[index] + weight * (target - before[index]), 0.15 * kUnitsPerLogOdds)
        << index.first << ", " << index.second;
    compared += before[index] != mapping.At(index.first, index.second) ? 1 : 0;
  }
  EXPECT_GT(compared, 50);
}

}  // namespace splinemap::signed_distance_test
