#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "lib/base/status.h"
#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "lib/matching/align.h"
#include "lib/matching/map_sketch.h"
#include "lib/simulation/simulation.h"
#include "tests/support/map_writer.h"

namespace splinemap::matching_test {

constexpr double kRad = std::numbers::pi / 180;

// Walls from corner to corner, closed.
void AddWalls(const std::vector<Eigen::Vector2d>& corners, simulation::World& world) {
  for (size_t k = 0; k < corners.size(); ++k) {
    const Eigen::Vector2d& next = corners[(k + 1) % corners.size()];
    simulation::Wall& wall = *world.add_wall();
    wall.set_x0_m(corners[k].x());
    wall.set_y0_m(corners[k].y());
    wall.set_x1_m(next.x());
    wall.set_y1_m(next.y());
  }
}

simulation::World Walls(const std::vector<Eigen::Vector2d>& corners) {
  simulation::World world;
  AddWalls(corners, world);
  return world;
}

// 8 x 5 m with a niche and a cupboard: like itself in no other place.
simulation::World Room() {
  simulation::World world =
      Walls({{0, 0}, {5, 0}, {5, -1}, {6.5, -1}, {6.5, 0}, {8, 0}, {8, 5}, {0, 5}});
  AddWalls({{1, 4}, {2.5, 4}, {2.5, 4.6}, {1, 4.6}}, world);
  return world;
}

simulation::World OtherRoom() {
  simulation::World world = Walls({{0, 0}, {4, 0}, {7, 2}, {7, 6}, {3, 6}, {3, 4}, {0, 4}});
  AddWalls({{5, 3}, {5.7, 3}, {5.7, 4.5}, {5, 4.5}}, world);
  return world;
}

// Where robots scan Room() and rooms that lie about the same place.
const std::vector<Eigen::Vector2d> kPlaces = {{0.8, 1}, {2, 2},     {3.4, 1.2}, {4, 3},
                                              {5.5, 1}, {6.4, 2.2}, {7, 4},     {3.3, 4.2}};

struct Mapping {
  Pose2 map_T_world{};
  double knot_m = 0.05;
  uint64_t seed = 1;
  std::vector<Eigen::Vector2d> places = kPlaces;
};

// Ten scans from each place, with 1 cm of noise.
std::shared_ptr<const MapView> MapOf(const simulation::World& world, const Mapping& mapping) {
  std::mt19937_64 random(mapping.seed);
  std::uniform_real_distribution<double> yaw_rad(-3, 3);
  const ScannerOptions scanner;
  BeamModel model({}, mapping.knot_m);
  ScanScratch scratch;
  MapWriter map({mapping.knot_m, {}});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  for (const Eigen::Vector2d& place : mapping.places) {
    for (int n = 0; n < 10; ++n) {
      const Pose2 world_T_robot{place, yaw_rad(random)};
      const Pose2 map_T_robot = mapping.map_T_world * world_T_robot;
      const std::vector<float> ranges_m = SimulateScan(world, 0, world_T_robot, scanner, random);
      std::vector<PlacedBeam> beams;
      for (size_t k = 0; k < ranges_m.size(); ++k) {
        if (ranges_m[k] == 0) continue;
        const double bearing_rad = map_T_robot.yaw_rad + scanner.FirstBearing() +
                                   static_cast<double>(k) * scanner.BearingStep();
        beams.push_back({map_T_robot.position_m,
                         {std::cos(bearing_rad), std::sin(bearing_rad)},
                         ranges_m[k],
                         true});
      }
      model.Accumulate(beams, scratch);
      scratch.CommitTo(layer, map.options().limits);
    }
  }
  return map.View();
}

void ExpectNear(const Pose2& found, const Pose2& expected, double most_m, double most_rad) {
  EXPECT_NEAR(found.position_m.x(), expected.position_m.x(), most_m);
  EXPECT_NEAR(found.position_m.y(), expected.position_m.y(), most_m);
  EXPECT_NEAR(WrapAngle(found.yaw_rad - expected.yaw_rad), 0, most_rad);
}

void ExpectRefused(const absl::StatusOr<Alignment>& found, const std::string& reason) {
  ASSERT_FALSE(found.ok());
  EXPECT_TRUE(absl::IsFailedPrecondition(found.status()));
  EXPECT_NE(ErrorText(found.status()).find(reason), std::string::npos) << found.status();
}

TEST(AlignTest, RecoversAnyTransformOfARoom) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> shift_m(-30, 30);
  std::uniform_real_distribution<double> yaw_rad(-std::numbers::pi, std::numbers::pi);
  const auto a = MapOf(Room(), {});
  for (uint64_t seed = 2; seed < 8; ++seed) {
    const double x_m = shift_m(random);
    const double y_m = shift_m(random);
    const Pose2 b_T_world{{x_m, y_m}, yaw_rad(random)};
    const auto b = MapOf(Room(), {.map_T_world = b_T_world, .seed = seed});
    const auto found = Align(*a, *b);
    ASSERT_TRUE(found.ok()) << found.status();
    // At the room, which is far from the origin of b.
    ExpectNear(found->a_T_b * b_T_world, {}, 0.01, 0.1 * kRad);
    EXPECT_GT(found->overlap_m2, 40);
    EXPECT_GT(found->overlap, 0.95);
    EXPECT_LE(found->overlap, 1);
    EXPECT_GT(found->agree_m, 25);
    EXPECT_LT(found->contradict_m, 1);
    EXPECT_LT(found->residual_m, 0.01);
    ASSERT_TRUE(found->runner_up.has_value());
    EXPECT_LT(found->runner_up->score_m, 0.7 * found->score_m);
  }
}

TEST(AlignTest, AlignsPartsThatSeeTheRoomFromItsEnds) {
  const Pose2 b_T_world{{-4, 7}, 2};
  const auto a = MapOf(Room(), {.places = {{0.8, 1}, {2, 2}, {3.4, 1.2}}});
  const auto b = MapOf(
      Room(), {.map_T_world = b_T_world, .seed = 2, .places = {{5.5, 1}, {6.4, 2.2}, {7, 4}}});
  const auto found = Align(*a, *b);
  ASSERT_TRUE(found.ok()) << found.status();
  ExpectNear(found->a_T_b, Inverse(b_T_world), 0.02, 0.2 * kRad);
}

TEST(AlignTest, TheOverlapIsAShareOfTheSmallerMap) {
  const auto whole = MapOf(Room(), {});
  const auto part = MapOf(Room(), {.seed = 2, .places = {{5.75, -0.4}}});
  const auto found = Align(*whole, *part);
  const auto exchanged = Align(*part, *whole);
  ASSERT_TRUE(found.ok() && exchanged.ok()) << found.status();
  EXPECT_GT(found->overlap, 0.95);
  EXPECT_LT(found->overlap_m2, 40);
  EXPECT_EQ(exchanged->overlap, found->overlap);
}

TEST(AlignTest, AlignsMapsOfDifferentKnotIntervals) {
  const Pose2 b_T_world{{3, -1}, -1.2};
  const auto a = MapOf(Room(), {});
  for (const double knot_m : {0.03, 0.08}) {
    const auto b = MapOf(Room(), {.map_T_world = b_T_world, .knot_m = knot_m, .seed = 2});
    const auto found = Align(*a, *b, {.min_score_m = 15});
    ASSERT_TRUE(found.ok()) << found.status();
    ExpectNear(found->a_T_b, Inverse(b_T_world), 0.02, 0.2 * kRad);
  }
}

TEST(AlignTest, TheSameMapsGiveTheSameBits) {
  const auto a = MapOf(Room(), {});
  const auto b = MapOf(Room(), {.map_T_world = {{3, -1}, -1.2}, .seed = 2});
  const auto first = Align(*a, *b);
  const auto second = Align(*a, *b);
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(first->a_T_b.position_m, second->a_T_b.position_m);
  EXPECT_EQ(first->a_T_b.yaw_rad, second->a_T_b.yaw_rad);
  EXPECT_EQ(first->covariance, second->covariance);
  EXPECT_EQ(first->score_m, second->score_m);
  EXPECT_EQ(first->runner_up->a_T_b.position_m, second->runner_up->a_T_b.position_m);
}

TEST(AlignTest, ExchangedMapsGiveTheInverse) {
  const auto a = MapOf(Room(), {});
  const auto b = MapOf(Room(), {.map_T_world = {{3, -1}, -1.2}, .seed = 2});
  const auto found = Align(*a, *b);
  const auto exchanged = Align(*b, *a);
  ASSERT_TRUE(found.ok() && exchanged.ok());
  ExpectNear(found->a_T_b * exchanged->a_T_b, {}, 1e-12, 1e-12);
  EXPECT_EQ(found->score_m, exchanged->score_m);
  // That of the inverse, by differences.
  Eigen::Matrix3d jacobian;
  constexpr double kStep = 1e-6;
  const auto inverse_moved = [&](int axis, double step) {
    Pose2 pose = found->a_T_b;
    if (axis < 2) {
      pose.position_m[axis] += step;
    } else {
      pose.yaw_rad += step;
    }
    const Pose2 inverse = Inverse(pose);
    return Eigen::Vector3d(inverse.position_m.x(), inverse.position_m.y(), inverse.yaw_rad);
  };
  for (int axis = 0; axis < 3; ++axis) {
    jacobian.col(axis) = (inverse_moved(axis, kStep) - inverse_moved(axis, -kStep)) / (2 * kStep);
  }
  EXPECT_TRUE(
      exchanged->covariance.isApprox(jacobian * found->covariance * jacobian.transpose(), 1e-6));
}

TEST(AlignTest, IsSurerAcrossAHallThanAlongIt) {
  const simulation::World hall =
      Walls({{0, 0}, {8, 0}, {8, -2}, {10, -2}, {10, 0}, {14, 0}, {14, 2}, {0, 2}});
  const std::vector<Eigen::Vector2d> places = {{1, 1}, {4, 1.2}, {7, 1}, {9, 0}, {12, 1}};
  const auto found =
      Align(*MapOf(hall, {.places = places}), *MapOf(hall, {.seed = 2, .places = places}));
  ASSERT_TRUE(found.ok()) << found.status();
  // At the middle of the hall.
  Eigen::Matrix3d to_middle = Eigen::Matrix3d::Identity();
  to_middle(0, 2) = -1;
  to_middle(1, 2) = 7;
  const Eigen::Matrix3d covariance = to_middle * found->covariance * to_middle.transpose();
  EXPECT_GT(covariance(0, 0), 1.5 * covariance(1, 1));
  EXPECT_GT(covariance(1, 1), 0);
  EXPECT_GT(covariance(2, 2), 0);
  EXPECT_GT(covariance.determinant(), 0);
}

TEST(AlignTest, RefusesTwoRooms) {
  ExpectRefused(Align(*MapOf(Room(), {}),
                      *MapOf(OtherRoom(), {.places = {{1, 1}, {2, 3}, {4, 2}, {6, 3}, {4, 5}}})),
                "too little in common");
}

TEST(AlignTest, RefusesARoomThatLooksTheSameTurnedRound) {
  const simulation::World room = Walls({{0, 0}, {8, 0}, {8, 5}, {0, 5}});
  ExpectRefused(Align(*MapOf(room, {}), *MapOf(room, {.map_T_world = {{1, 2}, 0.5}, .seed = 2})),
                "two places fit");
}

// Where the right place is one of the lesser overlap.
TEST(AlignTest, RefusesARowOfEqualRooms) {
  simulation::World row;
  for (int k = 0; k < 8; ++k) {
    const double x_m = 4 * k;
    // A room of 4 x 4 m, with a door to the corridor below it.
    AddWalls({{x_m, 4}, {x_m + 4, 4}}, row);
    AddWalls({{x_m, 0}, {x_m, 4}}, row);
    AddWalls({{x_m, 0}, {x_m + 1.5, 0}}, row);
    AddWalls({{x_m + 2.5, 0}, {x_m + 4, 0}}, row);
  }
  AddWalls({{32, 0}, {32, 4}}, row);
  AddWalls({{-4, -2}, {36, -2}}, row);
  const auto of_rooms = [&](double first_m, const Mapping& mapping) {
    Mapping of = mapping;
    of.places.clear();
    for (int k = 0; k < 2; ++k) {
      const double x_m = first_m + 4 * k;
      of.places.insert(of.places.end(), {{x_m + 1, 2}, {x_m + 3, 3}, {x_m + 2, -1}});
    }
    return MapOf(row, of);
  };
  // The next best place has 60 % of the score.
  ExpectRefused(Align(*of_rooms(8, {}), *of_rooms(12, {.seed = 2})), "two places fit");
}

TEST(AlignTest, RefusesOneCorner) {
  const simulation::World hall = Walls({{0, 0}, {40, 0}, {40, 40}, {0, 40}});
  ExpectRefused(
      Align(*MapOf(hall, {.places = {{3, 3}, {6, 4}, {4, 7}, {9, 3}}}),
            *MapOf(hall, {.seed = 2, .places = {{37, 37}, {34, 36}, {36, 33}, {31, 37}}})),
      "one corner alone");
}

TEST(AlignTest, RefusesKnotsThatDifferTooMuch) {
  const auto fine = MapOf(Room(), {});
  const auto coarse = MapOf(Room(), {.knot_m = 0.6});
  ExpectRefused(Align(*fine, *coarse), "--knot-interval-m");
}

TEST(AlignTest, SaysHowFarItIs) {
  double last = -1;
  int calls = 0;
  AlignOptions options;
  options.on_progress = [&](double share) {
    EXPECT_GT(share, last);
    EXPECT_LT(share, 1);
    last = share;
    ++calls;
  };
  const auto map = MapOf(Room(), {});
  ASSERT_TRUE(Align(*map, *map, options).ok());
  EXPECT_GT(calls, 10);
}

TEST(AlignTest, RefusesARoundRoom) {
  const std::vector<Eigen::Vector2d> places = {{3, 2}, {4, 3}, {5, 3}};
  std::vector<Eigen::Vector2d> corners;
  for (int k = 0; k < 72; ++k) {
    corners.emplace_back(4 + 3 * std::cos(5 * k * kRad), 2.5 + 3 * std::sin(5 * k * kRad));
  }
  ExpectRefused(Align(*MapOf(Walls(corners), {.places = places}),
                      *MapOf(Walls(corners), {.seed = 2, .places = places})),
                "two places fit");
}

TEST(AlignTest, RefusesABareCorridor) {
  simulation::World corridor;
  AddWalls({{-40, 0}, {60, 0}}, corridor);
  AddWalls({{-40, 2}, {60, 2}}, corridor);
  const std::vector<Eigen::Vector2d> places = {{0, 1}, {2, 0.7}, {4, 1.2}, {6, 1}, {8, 1}};
  const Pose2 b_T_world{{1, 2}, 30 * kRad};
  const auto a = MapOf(corridor, {.map_T_world = {{0, 0}, 20 * kRad}, .places = places});
  const auto b = MapOf(corridor, {.map_T_world = b_T_world, .seed = 2, .places = places});
  ExpectRefused(Align(*a, *b), "slide along the direction of 20 degrees");
  ExpectRefused(Align(*b, *a), "slide along the direction of 30 degrees");
}

TEST(AlignTest, RefusesMapsThatContradict) {
  simulation::World furnished = Room();
  for (double x_m = 1; x_m < 7; x_m += 1) {
    for (const double y_m : {1.7, 2.8}) {
      AddWalls({{x_m, y_m}, {x_m + 0.5, y_m}, {x_m + 0.5, y_m + 0.5}, {x_m, y_m + 0.5}}, furnished);
    }
  }
  const std::vector<Eigen::Vector2d> places = {{0.5, 0.8}, {2, 1}, {4, 0.8}, {6, 0.5}, {7.5, 2.5},
                                               {7, 4},     {5, 4}, {3, 3.8}, {0.5, 3}, {3, 2.5}};
  const auto a = MapOf(Room(), {.places = places});
  const auto b = MapOf(furnished, {.seed = 2, .places = places});
  ExpectRefused(Align(*a, *b, {.min_score_m = 5}), "contradict each other");
}

TEST(AlignTest, SaysHowMuchHasToAgree) {
  const auto a = MapOf(Room(), {});
  const auto b = MapOf(Room(), {.seed = 2});
  ExpectRefused(Align(*a, *b, {.min_score_m = 500}), "500.0 m have to agree");
}

TEST(AlignTest, RefusesMapsWithoutWallsAndMapsThatAreTooLarge) {
  const auto room = MapOf(Room(), {});
  ExpectRefused(Align(*room, MapView()), "map B: it has no walls");
  ExpectRefused(Align(MapView(), *room), "map A: it has no walls");
  MapWriter wide({0.05, {}});
  Layer& layer = wide.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  layer.EditTile({-5000, -5000}).control_points[0] = -1000;
  layer.EditTile({5000, 5000}).control_points[0] = -1000;
  ExpectRefused(Align(*room, *wide.View()), "splinemap crop");
}

TEST(MapSketchTest, WallsHaveTheirLengthAndPointOutOfTheRoom) {
  const simulation::World room = Walls({{0, 0}, {6, 0}, {6, 4}, {0, 4}});
  const Eigen::Vector2d middle_m(3, 2);
  for (const double turn_rad : {0.0, 0.3, std::numbers::pi / 4}) {
    const Pose2 map_T_world{{1, 1}, turn_rad};
    const auto map = MapOf(
        room, {.map_T_world = map_T_world, .places = {{1, 1}, {5, 3}, {3, 2}, {1, 3}, {5, 1}}});
    const auto sketch = MapSketch::Of(*map, {0.05});
    ASSERT_TRUE(sketch.ok());
    EXPECT_NEAR(sketch->wall_m(), 20, 0.5);
    double off_m = 0;
    for (const WallPoint& wall : sketch->walls()) {
      EXPECT_NEAR(wall.normal.norm(), 1, 1e-9);
      EXPECT_GT(wall.normal.dot(wall.point_m - map_T_world * middle_m), 0);
      const Eigen::Vector2d p =
          (Inverse(map_T_world) * wall.point_m - middle_m).cwiseAbs() - middle_m;
      off_m = std::max(off_m, std::abs(p.maxCoeff()));
    }
    EXPECT_LT(off_m, 0.06);
    EXPECT_TRUE(sketch->At(map_T_world * middle_m).is_open);
    EXPECT_FALSE(sketch->At(map_T_world * Eigen::Vector2d(0.2, 2)).is_open);
    EXPECT_TRUE(sketch->At(map_T_world * Eigen::Vector2d(0.2, 2)).is_free);
    EXPECT_FALSE(sketch->At({100, -100}).is_known);
  }
}

}  // namespace splinemap::matching_test
