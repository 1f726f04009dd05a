#include "lib/distance/distance_field.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <vector>

#include "lib/query/footprint.h"
#include "lib/query/obstacle_search.h"
#include "splinemap/local_map.h"
#include "tests/support/map_writer.h"

namespace splinemap::distance_field_test {

constexpr double kKnot_m = 0.05;  // as MapOptions has it
constexpr double kBound_m = DistanceField::kErrorBound * kKnot_m;
constexpr ControlPoint kFree = -1200;

// Layers that change commit by commit.
class World {
 public:
  explicit World(uint64_t seed, int num_layers = 1) : random_(seed) {
    for (int k = 0; k < num_layers; ++k) {
      map_.AddLayer({"robot", static_cast<uint64_t>(k)}, {1, 1});
    }
    NextCommit();
  }

  // What is put from now on is of the next commit, of any layer.
  void NextCommit() {
    layer_ = &map_.layer(random_() % map_.layers().size());
    layer_->BeginCommit();
  }
  void Put(int i, int j, int value) {
    layer_->EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
        static_cast<ControlPoint>(value);
  }
  void Fill(int i0, int j0, int width, int height, int value) {
    for (int j = j0; j < j0 + height; ++j) {
      for (int i = i0; i < i0 + width; ++i) Put(i, j, value);
    }
  }
  // Free but for noise in a square around the origin, with walls and holes in it.
  void BuildRooms(int half) {
    for (int j = -half; j <= half; ++j) {
      for (int i = -half; i <= half; ++i) Put(i, j, kFree + Between(-300, 300));
    }
    for (int wall = 0; wall < 8; ++wall) AddWall(half);
    for (int hole = 0; hole < 4; ++hole) {
      Fill(Between(-half, half - 7), Between(-half, half - 7), 5, 7, 0);
    }
  }
  void AddWall(int half) {
    int i = Between(-half, half);
    int j = Between(-half, half);
    const bool along_x = random_() % 2 == 0;
    for (int n = 0; n < 20; ++n) {
      Put(i, j, 1500 + 4 * Between(-300, 300));
      (along_x ? i : j) += 1;
      if (random_() % 5 == 0) (along_x ? j : i) += 1;
    }
  }
  int Between(int low, int high) { return std::uniform_int_distribution<int>(low, high)(random_); }
  Eigen::Vector2d Point(double extent_m) {
    std::uniform_real_distribution<double> coordinate(-extent_m, extent_m);
    const double x_m = coordinate(random_);
    return {x_m, coordinate(random_)};
  }
  std::shared_ptr<const MapView> View() { return map_.View(); }

 private:
  std::mt19937_64 random_;
  MapWriter map_{MapOptions{}};
  Layer* layer_;
};

DistanceField FieldOf(const std::shared_ptr<const MapView>& map,
                      const DistanceFieldOptions& options) {
  return DistanceFieldEditor(options).Update(map);
}

class ExactSearch {
 public:
  ExactSearch(std::shared_ptr<const MapView> map, const DistanceFieldOptions& options)
      : map_(std::move(map)),
        options_(options),
        bounds_(map_),
        search_(bounds_, options.occupied_log_odds, options.unknown) {}

  DistancesQuery::Distance At(const Eigen::Vector2d& point_m) {
    return FindDistance(search_, point_m, options_.max_distance_m, kKnot_m);
  }

 private:
  const std::shared_ptr<const MapView> map_;
  const DistanceFieldOptions options_;
  const SurfaceBounds bounds_;
  ObstacleSearch search_;
};

std::vector<DistanceFieldOptions> Choices() {
  std::vector<DistanceFieldOptions> choices;
  for (const UnknownPolicy unknown : {UnknownPolicy::kFree, UnknownPolicy::kBlocked}) {
    for (const double threshold : {kDefaultOccupied, -2.5, 3.0}) {
      for (const double max_distance_m : {0.4, 2.0}) {
        choices.push_back({max_distance_m, threshold, unknown});
      }
    }
  }
  return choices;
}

TEST(DistanceFieldTest, DiffersFromTheSearchByNoMoreThanItsBound) {
  for (uint64_t seed = 0; seed < 4; ++seed) {
    World world(seed);
    world.BuildRooms(48);
    const auto map = world.View();
    for (const DistanceFieldOptions& options : Choices()) {
      const DistanceField field = FieldOf(map, options);
      ExactSearch exact(map, options);
      int near = 0;
      for (int n = 0; n < 400; ++n) {
        const Eigen::Vector2d point_m = world.Point(n % 2 == 0 ? 2.6 : 4.5);
        const DistancesQuery::Distance expected = exact.At(point_m);
        const DistancesQuery::Distance distance = field.At(point_m);
        ASSERT_NEAR(distance.distance_m, expected.distance_m, kBound_m)
            << "seed " << seed << " at " << point_m.transpose() << " threshold "
            << options.occupied_log_odds << " unknown " << static_cast<int>(options.unknown);
        if (distance.gradient.isZero(0)) {
          ASSERT_TRUE(distance.distance_m == 0 || distance.distance_m == options.max_distance_m);
          continue;
        }
        ++near;
        ASSERT_NEAR(distance.gradient.norm(), 1, 1e-9);
        // Back along the gradient there is the obstacle.
        ASSERT_LE(exact.At(point_m - distance.distance_m * distance.gradient).distance_m, kBound_m);
      }
      EXPECT_GT(near, 50);
    }
  }
}

// As README.md says.
TEST(DistanceFieldTest, AnswersAPlanner) {
  World world(1);
  world.Fill(-20, -20, 60, 60, kFree);
  world.Fill(-20, 6, 60, 3, 2500);
  const auto map = world.View();
  DistanceFieldEditor editor({.max_distance_m = 0.6});
  DistanceField field = editor.Update(map);  // and again after changes: it costs what changed
  const DistancesQuery::Distance clearance = field.At({0.3, 0.7});  // from any thread
  EXPECT_NEAR(clearance.distance_m, 0.7 - 8.5 * kKnot_m, kKnot_m);
  EXPECT_GT(clearance.gradient.y(), 0.99);
}

TEST(DistanceFieldTest, DistancesAreThoseOfBruteForce) {
  for (const UnknownPolicy unknown : {UnknownPolicy::kFree, UnknownPolicy::kBlocked}) {
    World world(20);
    world.BuildRooms(40);
    const auto map = world.View();
    const DistanceFieldOptions options{.unknown = unknown};
    const DistanceField field = FieldOf(map, options);
    constexpr double kStep_m = kKnot_m / 4;
    std::vector<Eigen::Vector2d> obstacles_m;
    for (double y_m = -3; y_m < 3; y_m += kStep_m) {
      for (double x_m = -3; x_m < 3; x_m += kStep_m) {
        const SurfaceSample sample = map->Evaluate(x_m, y_m);
        if (sample.known ? sample.log_odds >= 0 : unknown == UnknownPolicy::kBlocked) {
          obstacles_m.emplace_back(x_m, y_m);
        }
      }
    }
    for (int n = 0; n < 60; ++n) {
      const Eigen::Vector2d point_m = world.Point(2);
      double least_m = options.max_distance_m;
      for (const Eigen::Vector2d& at_m : obstacles_m) {
        least_m = std::min(least_m, (at_m - point_m).norm());
      }
      // Steps may miss what is in the corner of a square.
      EXPECT_NEAR(field.At(point_m).distance_m, least_m, kBound_m + kStep_m);
    }
  }
}

// What DistanceField::At() says of a distance d, in knot intervals: of one of the four vertices the
// nearest is at most 0.62 farther from the point if d >= 1, and else less than 1.62 from it.
TEST(DistanceFieldTest, TheNearestOfAVertexIsNotMuchFarther) {
  const double kGolden = (std::sqrt(5.0) - 1) / 2;  // 0.618
  for (const double d : {0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0, 1.2, 1.5, 2.0, 4.0, 40.0}) {
    double worst = 0;
    for (int n = 0; n < 21 * 21 * 90; ++n) {
      const Eigen::Vector2d point(n % 21 / 20.0, n / 21 % 21 / 20.0);
      const double angle = n / (21 * 21) * M_PI / 45;
      const Eigen::Vector2d nearest = point + d * Eigen::Vector2d(std::cos(angle), std::sin(angle));
      double excess = 10;
      for (int k = 0; k < 4; ++k) {
        const Eigen::Vector2d vertex(k % 2, k / 2);
        excess = std::min(excess, (vertex - point).norm() + (vertex - nearest).norm() - d);
      }
      worst = std::max(worst, excess);
    }
    EXPECT_LT(std::min(d, 1.0) + worst, 1 + kGolden + 1e-9) << d;
  }
}

// Between two vertices of the grid, with specks behind both of them and one across: of that none of
// the four vertices knows.
TEST(DistanceFieldTest, HoldsItsBoundBetweenSpecksThatNoVertexIsNearestTo) {
  double worst = 0;
  for (const int reach : {3, 5, 8, 13, 20}) {
    for (int shift = 0; shift < 3; ++shift) {
      World world(1);
      world.Fill(-40, -40, 80, 80, kFree);
      world.Put(0, reach + 1, 2500);
      world.Put(0, -reach, 2500);
      world.Put(reach + shift, 0, 2200);
      world.Put(reach + shift, 1, 2200);
      const auto map = world.View();
      const DistanceFieldOptions options;
      const DistanceField field = FieldOf(map, options);
      ExactSearch exact(map, options);
      for (int n = 0; n < 2000; ++n) {
        const Eigen::Vector2d point_m = world.Point(3 * kKnot_m);
        const double error = std::abs(field.At(point_m).distance_m - exact.At(point_m).distance_m);
        worst = std::max(worst, error / kKnot_m);
      }
    }
  }
  EXPECT_LE(worst, DistanceField::kErrorBound);
  EXPECT_GT(worst, 0.2) << "this says nothing";
}

// Control points that are known alone are free around them, and occupied in the corners of what
// they make known: specks so close that those of four vertices may be others than the nearest.
TEST(DistanceFieldTest, HoldsItsBoundAmongSpecksBetweenFourVertices) {
  const DistanceFieldOptions options{.occupied_log_odds = -1};
  for (uint64_t seed = 0; seed < 5; ++seed) {
    World world(seed);
    for (int j = -20; j <= 20; j += 2) {
      for (int i = -20; i <= 20; i += 2) world.Put(i, j, world.Between(-1110, -1060));
    }
    const auto map = world.View();
    const DistanceField field = FieldOf(map, options);
    ExactSearch exact(map, options);
    for (int n = 0; n < 400; ++n) {
      Eigen::Vector2d point_m = world.Point(1);
      if (n % 2 == 0) {
        const Eigen::Vector2d corner(world.Between(-20, 20), world.Between(-20, 20));
        point_m = kKnot_m * (corner + Eigen::Vector2d(0.499, 0.499));
      }
      ASSERT_NEAR(field.At(point_m).distance_m, exact.At(point_m).distance_m, kBound_m);
    }
  }
}

// In the middle of four posts, whose ends come to every place in a square.
TEST(DistanceFieldTest, HoldsItsBoundBetweenPostsOnAllSides) {
  double worst = 0;
  for (int value = 400; value <= 2560; value += 45) {
    for (const int reach : {1, 2, 3, 6}) {
      World world(1);
      world.Fill(-20, -20, 40, 40, kFree);
      for (const int i : {-reach, reach + 1}) {
        for (const int j : {-reach, reach + 1}) world.Put(i, j, value);
      }
      const auto map = world.View();
      // Some are so low that they are occupied at a low level only.
      const DistanceFieldOptions options{.occupied_log_odds = -3};
      const Eigen::Vector2d middle_m = kKnot_m * Eigen::Vector2d(0.5, 0.5);
      const double error = FieldOf(map, options).At(middle_m).distance_m -
                           ExactSearch(map, options).At(middle_m).distance_m;
      worst = std::max(worst, std::abs(error) / kKnot_m);
    }
  }
  EXPECT_LE(worst, DistanceField::kErrorBound);
  EXPECT_GT(worst, 0.4) << "this says nothing";
}

TEST(DistanceFieldTest, IsMuchCloserBesideAWall) {
  World world(1);
  world.Fill(-60, -60, 120, 120, kFree);
  world.Fill(-60, 3, 120, 3, 2500);
  const auto map = world.View();
  const DistanceFieldOptions options;
  const DistanceField field = FieldOf(map, options);
  ExactSearch exact(map, options);
  for (int n = 0; n < 1000; ++n) {
    Eigen::Vector2d point_m = world.Point(1.5);
    point_m.y() = -0.1 - std::abs(point_m.y());
    const DistancesQuery::Distance distance = field.At(point_m);
    EXPECT_NEAR(distance.distance_m, exact.At(point_m).distance_m, 0.2 * kKnot_m);
    EXPECT_LT(distance.gradient.y(), -0.99);
  }
}

// An absent tile is one that has nothing.
bool IsTheSame(const DistanceField& a, const DistanceField& b, int32_t reach) {
  const DistanceTile nothing = [&] {
    DistanceTile tile;
    tile.longest.fill(reach);
    return tile;
  }();
  bool is_same = true;
  const auto compare = [&](const DistanceField& one, const DistanceField& other) {
    one.tiles().ForEach([&](TileKey key, const KeyTree<DistanceTile>::Entry& entry) {
      const DistanceTile* tile = other.tiles().Find(key);
      is_same = is_same && *entry.tile == (tile == nullptr ? nothing : *tile);
    });
  };
  compare(a, b);
  compare(b, a);
  return is_same;
}

int32_t Reach(const DistanceFieldOptions& options) {
  const auto reach =
      static_cast<int32_t>(std::ceil(8 * (options.max_distance_m / kKnot_m + std::sqrt(2.0))));
  return reach * reach;
}

TEST(DistanceFieldTest, IsThatOfTheMapWhateverWasSeenBefore) {
  int num_changed = 0;
  for (const DistanceFieldOptions& options : Choices()) {
    World world(7, 3);
    DistanceFieldEditor editor(options);
    std::vector<std::shared_ptr<const MapView>> views{world.View()};
    for (int commit = 0; commit < 14; ++commit) {
      world.NextCommit();
      if (commit % 5 == 0) world.BuildRooms(20 + 3 * commit);
      world.Fill(world.Between(-70, 60), world.Between(-70, 60), 9, 9,
                 commit % 3 == 1 ? 0 : 2 * kFree);
      world.AddWall(60);
      for (int n = 0; n < 40; ++n) {
        world.Put(world.Between(-70, 70), world.Between(-70, 70), world.Between(-2000, 2000));
      }
      views.push_back(world.View());
      // Now and then one of long ago, or the last once more.
      const auto& map = commit % 6 == 4   ? views[commit / 4]
                        : commit % 6 == 5 ? views[commit]
                                          : views[commit + 1];
      const DistanceField field = editor.Update(map);
      const DistanceField anew = FieldOf(map, options);
      ASSERT_TRUE(IsTheSame(field, anew, Reach(options))) << "commit " << commit;
      for (int n = 0; n < 100; ++n) {
        const Eigen::Vector2d point_m = world.Point(4.5);
        const DistancesQuery::Distance distance = field.At(point_m);
        const DistancesQuery::Distance expected = anew.At(point_m);
        ASSERT_EQ(distance.distance_m, expected.distance_m);
        ASSERT_EQ(distance.gradient, expected.gradient);
      }
      num_changed += static_cast<int>(field.tiles().size());
    }
  }
  EXPECT_GT(num_changed, 500);
}

// The end of a wall, or a part of it, moves over the boundary between two tiles, or two blocks of
// one, without a change in the other.
TEST(DistanceFieldTest, IsThatOfTheMapWhereObstaclesEndAtTheRimOfATileOrBlock) {
  for (int choice = 0; choice < 16; ++choice) {
    const bool along_x = choice % 2 == 0;
    const bool is_lower = choice / 2 % 2 == 0;
    const bool is_part = choice / 4 % 2 == 0;
    const int end = choice / 8 == 0 ? 32 : 40;
    World world(1);
    DistanceFieldEditor editor({});
    for (int value = -95; value >= -995; value -= 30) {
      world.NextCommit();
      for (int n = end - 12; n <= end + 12; ++n) {
        for (int m = 0; m < 30; ++m) {
          int put = kFree;
          if (m > 5 && m < 25 && (is_lower ? n < end : n > end)) put = 2560;
          if (m > 5 && m < 25 && n == end) put = is_part && (m < 14 || m > 16) ? -100 : value;
          along_x ? world.Put(n, m, put) : world.Put(m, n, put);
        }
      }
      const auto map = world.View();
      ASSERT_TRUE(IsTheSame(editor.Update(map), FieldOf(map, {}), Reach({})));
    }
  }
}

TEST(DistanceFieldTest, WhatIsBesideTheMapIsUnknownToItsLastPoint) {
  // Known in a tile and half a knot interval around it, or in a part of the tile.
  for (const int side : {32, 20}) {
    World world(1);
    world.Fill(0, 0, side, side, kFree);
    const auto map = world.View();
    const DistanceFieldOptions options{.unknown = UnknownPolicy::kBlocked};
    const DistanceField field = FieldOf(map, options);
    ExactSearch exact(map, options);
    for (int n = 0; n < 3000; ++n) {
      const Eigen::Vector2d point_m = Eigen::Vector2d(0.8, 0.8) + world.Point(n % 2 == 0 ? 1 : 3);
      ASSERT_NEAR(field.At(point_m).distance_m, exact.At(point_m).distance_m, kBound_m);
    }
  }
}

TEST(DistanceFieldTest, EarlierFieldsStayAsTheyWere) {
  World world(1);
  world.BuildRooms(40);
  const auto map = world.View();
  DistanceFieldEditor editor({});
  const DistanceField before = editor.Update(map);
  world.NextCommit();
  world.Fill(-40, -40, 80, 80, kFree);
  editor.Update(world.View());
  EXPECT_TRUE(IsTheSame(before, FieldOf(map, {}), Reach({})));
}

// What a scan does to most of a map: the surface changes, what is occupied does not.
TEST(DistanceFieldTest, CommitsThatMoveNoObstacleChangeNoTile) {
  World world(1);
  world.Fill(-60, -60, 120, 120, kFree);
  world.Fill(-40, 3, 80, 3, 2400);
  DistanceFieldEditor editor({});
  const DistanceField before = editor.Update(world.View());
  world.NextCommit();
  world.Fill(-60, -60, 120, 50, kFree - 100);
  const DistanceField after = editor.Update(world.View());
  after.tiles().ForEachChanged(before.tiles().version(),
                               [](TileKey, const KeyTree<DistanceTile>::Entry&) { FAIL(); });
}

TEST(DistanceFieldTest, OnlyTilesThatHadNothingNearerChange) {
  World world(1);
  world.Fill(-150, -150, 300, 300, kFree);
  world.Fill(-140, 0, 280, 3, 2400);
  const DistanceFieldOptions options{.max_distance_m = 4};
  DistanceFieldEditor editor(options);
  const DistanceField before = editor.Update(world.View());
  // A post 20 knot intervals off the wall: what is beyond the wall has that nearer.
  world.NextCommit();
  world.Put(5, 22, 2400);
  const DistanceField after = editor.Update(world.View());
  int num_changed = 0;
  after.tiles().ForEachChanged(before.tiles().version(),
                               [&](TileKey key, const KeyTree<DistanceTile>::Entry&) {
                                 ++num_changed;
                                 EXPECT_GE(key.ty, 0);
                               });
  EXPECT_GT(num_changed, 3);
  EXPECT_LT(num_changed, 20);
}

TEST(DistanceFieldTest, HasTilesWithinReachOfObstaclesAlone) {
  World world(1);
  world.Fill(-320, -320, 640, 640, kFree);
  world.Put(0, 0, 2400);
  DistanceFieldEditor editor({.max_distance_m = 1});
  const DistanceField field = editor.Update(world.View());
  EXPECT_LE(field.tiles().size(), 4U);
  // Without it they are one tile that has nothing.
  world.NextCommit();
  world.Put(0, 0, kFree);
  const DistanceField without = editor.Update(world.View());
  const auto nothing = without.tiles().Share({0, 0});
  without.tiles().ForEach(
      [&](TileKey, const KeyTree<DistanceTile>::Entry& entry) { EXPECT_EQ(entry.tile, nothing); });
  EXPECT_EQ(without.At({0.1, 0.1}).distance_m, 1);
}

TEST(DistanceFieldTest, OfAnEmptyMapEverythingIsUnknown) {
  const auto empty = std::make_shared<const MapView>();
  const DistanceField passes = FieldOf(empty, {});
  const DistanceField stops = FieldOf(empty, {.unknown = UnknownPolicy::kBlocked});
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  for (const Eigen::Vector2d& point_m :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(-3, 1e7), Eigen::Vector2d(nan, 0),
        Eigen::Vector2d(0, nan), Eigen::Vector2d(infinity, 0), Eigen::Vector2d(1e300, -1e300)}) {
    EXPECT_EQ(passes.At(point_m).distance_m, 2);
    EXPECT_EQ(stops.At(point_m).distance_m, 0);
    EXPECT_EQ(DistanceField().At(point_m).distance_m, 2);
    EXPECT_TRUE(passes.At(point_m).gradient.isZero(0));
    EXPECT_TRUE(stops.At(point_m).gradient.isZero(0));
  }
}

TEST(DistanceFieldTest, PointsThatAreNotOnTheMapAreUnknownBesideObstaclesToo) {
  World world(1);
  world.BuildRooms(10);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const DistanceField field = FieldOf(world.View(), {});
  for (const Eigen::Vector2d& point_m : {Eigen::Vector2d(nan, 0), Eigen::Vector2d(0, -nan),
                                         Eigen::Vector2d(1e300, 0), Eigen::Vector2d(0, -1e9)}) {
    EXPECT_EQ(field.At(point_m).distance_m, 2);
  }
}

TEST(DistanceFieldTest, TakesEveryGreatestDistanceThatQueriesTake) {
  World world(1);
  world.Fill(-20, -20, 40, 40, kFree);
  world.Fill(-3, -3, 6, 6, 2400);
  const auto map = world.View();
  for (const double max_distance_m : {0.0, 0.01, 0.05, 30.0, DistancesQuery::kMaxDistance_m}) {
    const DistanceFieldOptions options{.max_distance_m = max_distance_m};
    const DistanceField field = FieldOf(map, options);
    ExactSearch exact(map, options);
    for (int n = 0; n < 300; ++n) {
      const Eigen::Vector2d point_m = world.Point(1.2 * max_distance_m + 0.5);
      ASSERT_NEAR(field.At(point_m).distance_m, exact.At(point_m).distance_m, kBound_m)
          << max_distance_m;
    }
  }
}

TEST(DistanceFieldTest, AMapOfAnotherKnotIntervalIsAnsweredFromTheFirstUpdateOn) {
  World world(1);
  world.BuildRooms(30);
  const auto map = world.View();
  DistanceFieldEditor editor({});
  editor.Update(map);
  for (const double knot_interval_m : {0.1, 0.02}) {
    auto other = std::make_shared<MapView>(*map);
    other->options.knot_interval_m = knot_interval_m;
    const DistanceField field = editor.Update(other);
    const LocalMap exact(other);
    for (int n = 0; n < 200; ++n) {
      const Eigen::Vector2d point_m = world.Point(90 * knot_interval_m);
      const double expected_m = exact.Ask(DistancesQuery{{point_m}})->distances[0].distance_m;
      EXPECT_NEAR(field.At(point_m).distance_m, expected_m,
                  DistanceField::kErrorBound * knot_interval_m);
    }
  }
}

}  // namespace splinemap::distance_field_test
