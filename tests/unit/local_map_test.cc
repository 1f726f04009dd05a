#include "splinemap/local_map.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <random>
#include <vector>

#include "lib/geometry/angle.h"
#include "tests/support/map_writer.h"

namespace splinemap::local_map_test {

constexpr double kKnot_m = 0.05;   // as MapOptions has it
constexpr double kExtent_m = 2.4;  // of the random maps, each way from the origin

// SPLINEMAP_SEGMENTS=1000000 for the long run.
int Repetitions(int usual) {
  const char* text = std::getenv("SPLINEMAP_SEGMENTS");
  return text == nullptr ? usual : std::atoi(text);
}

// Rooms, walls, noise and places that were never seen, over nine tiles and more.
std::shared_ptr<const MapView> RandomMap(uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<int> knot(-48, 48);
  std::uniform_int_distribution<int> noise(-300, 300);
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  const auto put = [&](int i, int j, int value) {
    layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
        static_cast<ControlPoint>(std::clamp(value, -2560, 2560));
  };
  for (int j = -48; j <= 48; ++j) {
    for (int i = -48; i <= 48; ++i) put(i, j, -1200 + noise(random));
  }
  for (int wall = 0; wall < 8; ++wall) {
    int i = knot(random);
    int j = knot(random);
    const bool along_x = random() % 2 == 0;
    for (int n = 0; n < 20; ++n) {
      put(i, j, 1500 + 4 * noise(random));
      (along_x ? i : j) += 1;
      if (random() % 5 == 0) (along_x ? j : i) += 1;
    }
  }
  for (int hole = 0; hole < 4; ++hole) {
    const int i0 = knot(random);
    const int j0 = knot(random);
    for (int j = j0; j < j0 + 7; ++j) {
      for (int i = i0; i < i0 + 5; ++i) put(i, j, 0);
    }
  }
  return map.View();
}

class Chance {
 public:
  explicit Chance(uint64_t seed) : random_(seed) {}
  double Between(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  Eigen::Vector2d Point(double extent_m = kExtent_m) {
    return {Between(-extent_m, extent_m), Between(-extent_m, extent_m)};
  }
  bool Toss() { return random_() % 2 == 0; }
  double Threshold() { return Toss() ? kDefaultOccupied : Between(-3, 5); }

 private:
  std::mt19937_64 random_;
};

Occupancy At(const MapView& map, const Eigen::Vector2d& point_m, double threshold) {
  const SurfaceSample sample = map.Evaluate(point_m.x(), point_m.y());
  if (!sample.known) return Occupancy::kUnknown;
  return sample.log_odds >= threshold ? Occupancy::kOccupied : Occupancy::kFree;
}

bool Ends(Occupancy occupancy, UnknownPolicy unknown) {
  return occupancy == Occupancy::kOccupied ||
         (occupancy == Occupancy::kUnknown && unknown == UnknownPolicy::kBlocked);
}

TEST(LocalMapTest, RaysEndWhereStepsAlongThemDo) {
  int hits = 0;
  int unknowns = 0;
  for (uint64_t seed = 0; seed < 8; ++seed) {
    const auto map = RandomMap(seed);
    const LocalMap local(map);
    Chance chance(seed);
    for (int n = 0; n < 100; ++n) {
      const Ray ray{chance.Point(2.8), chance.Between(-4, 4), chance.Between(0, 4)};
      const RaysQuery query{{ray},
                            chance.Threshold(),
                            chance.Toss() ? UnknownPolicy::kBlocked : UnknownPolicy::kFree};
      const RaysQuery::End end = local.Ask(query)->ends[0];
      // The point where it ends is what it says; up to there is nothing that lasts for a step.
      const Eigen::Vector2d direction = UnitVector(ray.bearing_rad);
      constexpr double kStep_m = 0.0005;
      for (double range_m = 0; range_m < end.range_m - 1e-6; range_m += kStep_m) {
        const Eigen::Vector2d point_m = ray.origin_m + range_m * direction;
        ASSERT_FALSE(Ends(At(*map, point_m, query.occupied_log_odds), query.unknown))
            << "seed " << seed << " ray " << n << " at " << range_m << " of " << end.range_m;
      }
      if (end.occupancy == Occupancy::kFree) {
        EXPECT_EQ(end.range_m, ray.max_range_m);
        continue;
      }
      (end.occupancy == Occupancy::kOccupied ? hits : unknowns) += 1;
      const Eigen::Vector2d beyond_m = ray.origin_m + (end.range_m + 1e-7) * direction;
      if (end.occupancy == Occupancy::kUnknown) {
        EXPECT_EQ(At(*map, beyond_m, 0), Occupancy::kUnknown);
      } else {
        EXPECT_GT(map->Evaluate(beyond_m.x(), beyond_m.y()).log_odds,
                  query.occupied_log_odds - 1e-3);
      }
    }
  }
  EXPECT_GT(hits, 100);
  EXPECT_GT(unknowns, 100);
}

TEST(LocalMapTest, ARayCrossesAFlatSlopeWhereItsFormulaSays) {
  // Control points i * 64: log-odds are x / knot * 64 / 256.
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  layer.BeginCommit();
  for (int j = -40; j < 40; ++j) {
    for (int i = -40; i < 40; ++i) {
      layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
          static_cast<ControlPoint>(i == 0 ? 1 : 64 * i);
    }
  }
  const LocalMap local(map.View());
  const RaysQuery query{{{{-1, 0.2}, 0, 3}, {{-1, -0.7}, 0.5, 3}}, 3.3, UnknownPolicy::kBlocked};
  const auto ends = local.Ask(query)->ends;
  const double x_m = 3.3 * 4 * kKnot_m;
  EXPECT_NEAR(ends[0].range_m, 1 + x_m, 1e-7);
  EXPECT_NEAR(ends[1].range_m, (1 + x_m) / std::cos(0.5), 1e-7);
}

// All points of the disc at some places of the way.
struct Touched {
  bool occupied = false;
  bool unknown = false;
};
Touched CheckDisc(const MapView& map, const Eigen::Vector2d& centre_m, double radius_m,
                  double threshold) {
  Touched touched;
  constexpr double kStep_m = 0.01;
  const auto check = [&](const Eigen::Vector2d& offset_m) {
    const Occupancy occupancy = At(map, centre_m + offset_m, threshold);
    touched.occupied = touched.occupied || occupancy == Occupancy::kOccupied;
    touched.unknown = touched.unknown || occupancy == Occupancy::kUnknown;
  };
  check({0, 0});
  for (double r_m = radius_m; r_m > 0; r_m -= kStep_m) {
    const int count = std::max(4, static_cast<int>(2 * M_PI * r_m / kStep_m));
    for (int n = 0; n < count; ++n) check(r_m * UnitVector(2 * M_PI * n / count));
  }
  return touched;
}

TEST(LocalMapTest, SweepsEndWhereStepsOfADiscDo) {
  int counts[3] = {};
  int certified = 0;
  for (uint64_t seed = 0; seed < 8; ++seed) {
    const auto map = RandomMap(100 + seed);
    const LocalMap local(map);
    Chance chance(seed);
    for (int n = 0; n < 40; ++n) {
      const Eigen::Vector2d from_m = chance.Point();
      Sweep sweep{{from_m, from_m + chance.Point(0.5), from_m + chance.Point(0.5)},
                  chance.Toss() ? 0.0 : chance.Between(0, 0.25)};
      const SweepsQuery query{{sweep},
                              chance.Threshold(),
                              chance.Toss() ? UnknownPolicy::kBlocked : UnknownPolicy::kFree};
      const SweepsQuery::Result result = local.Ask(query)->results[0];
      ++counts[static_cast<int>(result.occupancy)];
      certified += result.is_certified ? 1 : 0;
      double gone_m = 0;
      for (size_t k = 0; k + 1 < sweep.path_m.size(); ++k) {
        const Eigen::Vector2d step = sweep.path_m[k + 1] - sweep.path_m[k];
        for (double way_m = 0; way_m < step.norm(); way_m += 0.02) {
          if (gone_m + way_m >= result.free_m) break;
          const Touched touched = CheckDisc(*map, sweep.path_m[k] + way_m / step.norm() * step,
                                            sweep.radius_m, query.occupied_log_odds);
          ASSERT_FALSE(touched.occupied) << "seed " << seed << " sweep " << n;
          ASSERT_FALSE(touched.unknown && query.unknown == UnknownPolicy::kBlocked);
        }
        gone_m += step.norm();
      }
      if (result.occupancy == Occupancy::kFree) {
        EXPECT_NEAR(result.free_m, gone_m, 1e-9);
        continue;
      }
      // The contact is at the boundary of the disc there, and is what is said.
      double left_m = result.free_m;
      Eigen::Vector2d centre_m = sweep.path_m[0];
      for (size_t k = 0; k + 1 < sweep.path_m.size(); ++k) {
        const Eigen::Vector2d step = sweep.path_m[k + 1] - sweep.path_m[k];
        const double part = std::min(left_m, step.norm());
        centre_m = sweep.path_m[k] + part / step.norm() * step;
        left_m -= part;
        if (left_m <= 0) break;
      }
      EXPECT_LE((result.contact_m - centre_m).norm(), sweep.radius_m + kKnot_m / 32);
      double most = -1e9;
      bool known = false;
      bool unknown = false;
      for (int a = -4; a <= 4; ++a) {
        for (int b = -4; b <= 4; ++b) {
          const Eigen::Vector2d point_m = result.contact_m + kKnot_m / 32 * Eigen::Vector2d(a, b);
          const SurfaceSample sample = map->Evaluate(point_m.x(), point_m.y());
          most = std::max(most, sample.known ? sample.log_odds : -1e9);
          known = known || sample.known;
          unknown = unknown || !sample.known;
        }
      }
      if (result.occupancy == Occupancy::kUnknown) {
        EXPECT_TRUE(unknown);
      } else {
        EXPECT_TRUE(known);
        EXPECT_GT(most, query.occupied_log_odds - 0.1) << "seed " << seed << " sweep " << n;
      }
    }
  }
  EXPECT_GT(*std::min_element(std::begin(counts), std::end(counts)), 20);
  EXPECT_GT(certified, 50);
}

TEST(LocalMapTest, CertifiedAnswersAreNeverWrong) {
  const int repetitions = Repetitions(20'000);
  int certified = 0;
  std::vector<std::shared_ptr<const MapView>> maps;
  for (uint64_t seed = 0; seed < 20; ++seed) maps.push_back(RandomMap(200 + seed));
  Chance chance(3);
  for (size_t m = 0; m < maps.size(); ++m) {
    const LocalMap local(maps[m]);
    for (int n = 0; n < repetitions / static_cast<int>(maps.size()); ++n) {
      const Eigen::Vector2d from_m = chance.Point();
      const Sweep sweep{{from_m, from_m + chance.Point(0.4)}, chance.Between(0, 0.2)};
      const SweepsQuery query{{sweep},
                              chance.Threshold(),
                              chance.Toss() ? UnknownPolicy::kBlocked : UnknownPolicy::kFree};
      const SweepsQuery::Result result = local.Ask(query)->results[0];
      if (!result.is_certified) continue;
      ++certified;
      if (result.occupancy == Occupancy::kFree) {
        // Random points of the footprint's way.
        const Eigen::Vector2d step = sweep.path_m[1] - sweep.path_m[0];
        for (int k = 0; k < 30; ++k) {
          const Eigen::Vector2d point_m =
              from_m + chance.Between(0, 1) * step +
              sweep.radius_m * std::sqrt(chance.Between(0, 1)) * UnitVector(chance.Between(-3, 3));
          ASSERT_FALSE(Ends(At(*maps[m], point_m, query.occupied_log_odds), query.unknown));
        }
        continue;
      }
      // A square that was decided as a whole: just beyond the contact it is what was said.
      const Eigen::Vector2d centre_m =
          from_m + result.free_m * (sweep.path_m[1] - from_m).normalized();
      const Eigen::Vector2d away = result.contact_m - centre_m;
      bool is_there = false;
      for (int k = 0; k < 8 && !is_there; ++k) {
        const Eigen::Vector2d point_m = result.contact_m + 1e-7 * UnitVector(k * M_PI / 4 + 0.1);
        is_there = At(*maps[m], point_m, query.occupied_log_odds - 1e-9) == result.occupancy;
      }
      ASSERT_TRUE(is_there) << "at " << result.contact_m.transpose() << ", " << away.norm();
    }
  }
  EXPECT_GT(certified, repetitions / 4);
}

// The most log-odds of what is known in a square around a point.
double MostWithin(const MapView& map, const Eigen::Vector2d& point_m, double reach_m) {
  constexpr int kSteps = 20;
  double most = -1e9;
  for (int a = -kSteps; a <= kSteps; ++a) {
    for (int b = -kSteps; b <= kSteps; ++b) {
      const Eigen::Vector2d at_m = point_m + reach_m / kSteps * Eigen::Vector2d(a, b);
      const SurfaceSample sample = map.Evaluate(at_m.x(), at_m.y());
      if (sample.known) most = std::max(most, sample.log_odds);
    }
  }
  return most;
}

TEST(LocalMapTest, DistancesAreThoseOfBruteForce) {
  int found = 0;
  for (uint64_t seed = 0; seed < 6; ++seed) {
    const auto map = RandomMap(300 + seed);
    const LocalMap local(map);
    Chance chance(seed);
    const double threshold = chance.Threshold();
    constexpr double kStep_m = kKnot_m / 8;
    std::vector<Eigen::Vector2d> occupied_m;
    for (double y_m = -3.6; y_m < 3.6; y_m += kStep_m) {
      for (double x_m = -3.6; x_m < 3.6; x_m += kStep_m) {
        const Eigen::Vector2d point_m(x_m, y_m);
        if (At(*map, point_m, threshold) == Occupancy::kOccupied) occupied_m.push_back(point_m);
      }
    }
    for (int n = 0; n < 100; ++n) {
      const DistancesQuery query{{chance.Point(4)}, chance.Between(0, 3), threshold};
      const Eigen::Vector2d point_m = query.points_m[0];
      const DistancesQuery::Distance distance = local.Ask(query)->distances[0];
      double least_m = query.max_distance_m;
      for (const Eigen::Vector2d& at_m : occupied_m) {
        least_m = std::min(least_m, (at_m - point_m).norm());
      }
      EXPECT_LE(distance.distance_m, least_m + 1e-9) << "seed " << seed << " point " << n;
      if (distance.distance_m == query.max_distance_m || distance.distance_m == 0) continue;
      ++found;
      EXPECT_NEAR(distance.gradient.norm(), 1, 1e-9);
      // Where it says that the obstacle is, one is.
      const Eigen::Vector2d nearest_m = point_m - distance.distance_m * distance.gradient;
      EXPECT_GT(MostWithin(*map, nearest_m, kKnot_m / 16), threshold - 0.1)
          << "seed " << seed << " point " << n;
    }
  }
  EXPECT_GT(found, 100);
}

TEST(LocalMapTest, LaterMapsAreAnsweredAsIfTheyWereTheFirst) {
  MapWriter map(MapOptions{});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  LocalMap growing(map.View());
  Chance chance(5);
  std::shared_ptr<const MapView> former;
  for (int commit = 0; commit < 30; ++commit) {
    layer.BeginCommit();
    for (int n = 0; n < 200; ++n) {
      const auto i = static_cast<int>(chance.Between(-60, 60));
      const auto j = static_cast<int>(chance.Between(-60, 60));
      layer.EditTile(TileOf(i, j)).control_points[IndexInTile(i, j)] =
          static_cast<ControlPoint>(chance.Between(-900, 300));
    }
    // Now and then what was before once more.
    const auto view = commit % 7 == 6 ? former : map.View();
    former = view;
    growing.Use(view);
    const LocalMap fresh(view);
    RaysQuery rays{.rays = {}, .unknown = UnknownPolicy::kFree};
    SweepsQuery sweeps{.sweeps = {}, .unknown = UnknownPolicy::kFree};
    DistancesQuery distances;
    for (int n = 0; n < 40; ++n) {
      rays.rays.push_back({chance.Point(), chance.Between(-4, 4), 5});
      sweeps.sweeps.push_back({{chance.Point(), chance.Point()}, 0.1});
      distances.points_m.push_back(chance.Point());
    }
    const auto expected = fresh.Ask(rays)->ends;
    const auto ends = growing.Ask(rays)->ends;
    const auto expected_results = fresh.Ask(sweeps)->results;
    const auto results = growing.Ask(sweeps)->results;
    const auto expected_distances = fresh.Ask(distances)->distances;
    const auto all_distances = growing.Ask(distances)->distances;
    for (size_t n = 0; n < ends.size(); ++n) {
      EXPECT_EQ(ends[n].range_m, expected[n].range_m);
      EXPECT_EQ(ends[n].occupancy, expected[n].occupancy);
      EXPECT_EQ(results[n].free_m, expected_results[n].free_m);
      EXPECT_EQ(all_distances[n].distance_m, expected_distances[n].distance_m);
    }
  }
}

TEST(LocalMapTest, WaysAndRaysWithoutEndEnd) {
  const LocalMap local(RandomMap(1));
  const LocalMap empty(std::make_shared<const MapView>());
  for (const LocalMap* map : {&local, &empty}) {
    for (const UnknownPolicy unknown : {UnknownPolicy::kBlocked, UnknownPolicy::kFree}) {
      const RaysQuery rays{
          {{{-1e9, 0.3}, 0, 2e9}, {{5, 5}, 1, 1e300}, {{1e300, 0}, 3, 1}}, 50, unknown};
      const SweepsQuery sweeps{
          {{{{-1e9, 0.3}, {1e9, 0.3}}, 10}, {{{1e10, 0}}, 1}, {{{0, 0}}, 0}}, 50, unknown};
      const auto expected =
          unknown == UnknownPolicy::kBlocked ? Occupancy::kUnknown : Occupancy::kFree;
      const auto ends = map->Ask(rays)->ends;
      for (const auto& end : ends) EXPECT_EQ(end.occupancy, expected);
      const auto results = map->Ask(sweeps)->results;
      EXPECT_EQ(results[0].occupancy, expected);
      EXPECT_EQ(results[1].occupancy, expected);
    }
    EXPECT_FALSE(map->Ask(SweepsQuery{{{{{0, 0}, {1e300, 0}}, 1}}}).ok());
    EXPECT_EQ(map->Ask(DistancesQuery{{{1e300, -1e300}}, 2, 50})->distances[0].distance_m, 2);
  }
}

}  // namespace splinemap::local_map_test
