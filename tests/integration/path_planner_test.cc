#include "clients/planner/path_planner.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "lib/base/status.h"

namespace splinemap::path_planner_test {

using Eigen::Vector2d;

// Free but for a wall along y = 0, from x = -10 to the gap's left end and from its right one to 10.
class Wall : public QueryableMap {
 public:
  explicit Wall(double gap_m) : half_gap_m_(gap_m / 2) {}

  double DistanceTo(const Vector2d& point_m) const {
    return Vector2d(std::max(half_gap_m_ - std::abs(point_m.x()), 0.0), point_m.y()).norm();
  }
  void BreakAfter(int questions) { questions_left_ = questions; }

  absl::StatusOr<AnyAnswer> Answer(const SweepsQuery& query) const {
    if (questions_left_ && (*questions_left_)-- <= 0) return absl::UnavailableError("no map");
    SweepsQuery::Answer answer;
    for (const Sweep& sweep : query.sweeps) {
      SweepsQuery::Result result;
      for (size_t k = 0; k < sweep.path_m.size(); ++k) {
        const Vector2d& from = sweep.path_m[k == 0 ? 0 : k - 1];
        for (double share = 0; share <= 1; share += 0.02) {
          const Vector2d centre_m = from + share * (sweep.path_m[k] - from);
          if (DistanceTo(centre_m) <= sweep.radius_m) result.occupancy = Occupancy::kOccupied;
        }
      }
      answer.results.push_back(result);
    }
    return answer;
  }
  absl::StatusOr<AnyAnswer> Answer(const DistancesQuery& query) const {
    DistancesQuery::Answer answer;
    for (const Vector2d& point_m : query.points_m) {
      answer.distances.push_back({std::min(DistanceTo(point_m), query.max_distance_m), {}});
    }
    return answer;
  }
  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override {
    if (const auto* sweeps = std::get_if<const SweepsQuery*>(&query)) return Answer(**sweeps);
    if (const auto* distances = std::get_if<const DistancesQuery*>(&query)) {
      return Answer(**distances);
    }
    return absl::UnimplementedError("not asked by planners");
  }

 private:
  const double half_gap_m_;
  mutable std::optional<int> questions_left_;
};

constexpr Region kBounds = {-10, -5, 10, 5};

absl::StatusOr<Path> Plan(const Wall& wall, const Vector2d& start_m, const Vector2d& goal_m) {
  return PlanPath(wall, kBounds, start_m, goal_m,
                  {.radius_m = 0.2, .give_up_after = std::chrono::milliseconds(500)});
}

TEST(PathPlannerTest, ThePathGoesThroughTheGapAndKeepsAwayFromItsEnd) {
  const Wall wall(3);  // the straight line passes its end at 0.3 m
  const absl::StatusOr<Path> path = Plan(wall, {1.2, -3}, {1.2, 3});
  ASSERT_TRUE(path.ok()) << path.status();
  EXPECT_EQ(path->front(), Vector2d(1.2, -3));
  EXPECT_EQ(path->back(), Vector2d(1.2, 3));
  EXPECT_TRUE(IsFree(wall, *path, 0.2).value());
  double length_m = 0;
  double least_m = 10;
  for (size_t k = 1; k < path->size(); ++k) {
    const Vector2d leg = (*path)[k] - (*path)[k - 1];
    length_m += leg.norm();
    for (double share = 0; share <= 1; share += 0.001) {
      least_m = std::min(least_m, wall.DistanceTo((*path)[k - 1] + share * leg));
    }
  }
  EXPECT_LT(length_m, 6.3);
  EXPECT_GT(least_m, 0.42);
}

TEST(PathPlannerTest, AGapNarrowerThanTheRobotIsNoWay) {
  EXPECT_TRUE(absl::IsNotFound(Plan(Wall(0.38), {-3, -2}, {3, 2}).status()));
}

TEST(PathPlannerTest, AnEndInAnObstacleIsNamed) {
  const absl::Status start = Plan(Wall(1), {-3, 0.1}, {3, 2}).status();
  EXPECT_TRUE(absl::IsNotFound(start));
  EXPECT_EQ(ErrorText(start).substr(0, 9), "the start");
  EXPECT_EQ(ErrorText(Plan(Wall(1), {-3, 2}, {3, 0.1}).status()).substr(0, 8), "the goal");
}

TEST(PathPlannerTest, AMapThatCannotBeAskedIsNoObstacle) {
  Wall wall(1);
  wall.BreakAfter(20);
  EXPECT_TRUE(absl::IsUnavailable(Plan(wall, {-3, -2}, {3, 2}).status()));
}

}  // namespace splinemap::path_planner_test
