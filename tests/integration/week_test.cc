// A week in an office: a cupboard is moved, a door is closed, somebody walks by. Prints the figures
// of tests/bench/README.md.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "lib/map/occupancy_changes.h"
#include "lib/mapping/archive_edit.h"
#include "lib/mapping/fold.h"
#include "lib/simulation/simulation.h"
#include "tests/bench/accuracy/score.h"

namespace splinemap::week_test {

using Eigen::Vector2d;

constexpr int kDays = 7;
constexpr int kCupboardMoves = 3;
constexpr int kDoorCloses = 5;
constexpr MapOptions kOptions{0.05, {-64 * kUnitsPerLogOdds, 64 * kUnitsPerLogOdds}};

void AddBox(double x0_m, double y0_m, double side_m, simulation::World& world) {
  const std::vector<Vector2d> corners = {
      {x0_m, y0_m}, {x0_m + side_m, y0_m}, {x0_m + side_m, y0_m + side_m}, {x0_m, y0_m + side_m}};
  for (size_t k = 0; k < corners.size(); ++k) {
    const Vector2d& next = corners[(k + 1) % corners.size()];
    simulation::Wall& wall = *world.add_wall();
    wall.set_x0_m(corners[k].x());
    wall.set_y0_m(corners[k].y());
    wall.set_x1_m(next.x());
    wall.set_y1_m(next.y());
  }
}

const Vector2d kCupboardWas(9, 3.2);
const Vector2d kCupboardIs(12.5, 3.2);
constexpr double kCupboard_m = 0.6;
// The door, from x 2.5 to 3.5.
constexpr double kDoorY_m = 5.5;

simulation::World WorldOf(int day) {
  simulation::World world = OfficeFloor();
  for (simulation::Wall& wall : *world.mutable_wall()) {
    if (!wall.has_from_s()) continue;  // but the door
    day >= kDoorCloses ? wall.clear_from_s() : wall.set_from_s(1e8);
  }
  const Vector2d cupboard_m = day >= kCupboardMoves ? kCupboardIs : kCupboardWas;
  AddBox(cupboard_m.x(), cupboard_m.y(), kCupboard_m, world);
  return world;
}

// Up and down the corridor.
void AddPerson(double time_s, simulation::World& world) {
  simulation::Pillar& person = *world.add_pillar();
  person.set_x_m(12 + 11 * std::sin(time_s / 9));
  person.set_y_m(6.8);
  person.set_radius_m(0.25);
}

class Week {
 public:
  // A drive at 5 scans a second that begins at an hour of a day.
  void Drive(int day, int hour, bool somebody_walks_by) {
    const simulation::World world = WorldOf(day);
    const auto drive = *splinemap::Drive::Plan(world);
    for (double time_s = 0; time_s < drive.duration_s(); time_s += 0.2) {
      simulation::World now = world;
      if (somebody_walks_by) AddPerson(time_s, now);
      const Utime utime = TimeOf(day, hour) + std::chrono::microseconds(std::llround(1e6 * time_s));
      archive_.Add(ScanAt(now, utime, drive.PoseAt(time_s)), {});
    }
  }
  static Utime TimeOf(int day, int hour) { return std::chrono::hours(24 * (day + 20'000) + hour); }

  const ScanArchive& archive() const { return archive_; }

  // Hits of walls that are there now, and what is free before them.
  void AddTruth(std::vector<Vector2d>& hits, std::vector<Vector2d>& free) {
    const simulation::World world = WorldOf(kDays);
    const auto drive = *splinemap::Drive::Plan(world);
    std::uniform_real_distribution<double> share(0, 1);
    for (double time_s = 0.1; time_s < drive.duration_s(); time_s += 1) {
      const std::shared_ptr<const PosedScan> scan = ScanAt(world, Utime(0), drive.PoseAt(time_s));
      PlacedScan placed;
      Place(*scan, {}, placed);
      for (size_t k = 0; k < placed.beams.size(); k += 4) {
        const PlacedBeam& beam = placed.beams[k];
        hits.push_back(beam.origin_world_m + beam.range_m * beam.direction_world);
        free.push_back(beam.origin_world_m +
                       share(random_) * (beam.range_m - 0.1) * beam.direction_world);
      }
    }
  }

 private:
  std::shared_ptr<const PosedScan> ScanAt(const simulation::World& world, Utime utime,
                                          const Pose2& pose) {
    auto scan = std::make_shared<PosedScan>();
    scan->utime = utime;
    scan->world_T_robot = FixedPose2::Nearest(pose);
    scan->robot_T_sensor = {FixedPose2()};
    const std::vector<float> ranges_m = SimulateScan(world, 0, pose, scanner_, random_);
    for (size_t k = 0; k < ranges_m.size(); ++k) {
      if (ranges_m[k] == 0) continue;
      const double bearing_rad =
          scanner_.FirstBearing() + static_cast<double>(k) * scanner_.BearingStep();
      Beam beam;
      beam.bearing_rad = static_cast<float>(bearing_rad);
      beam.range_m = ranges_m[k];
      beam.hit = true;
      scan->beams.push_back(beam);
    }
    return scan;
  }

  const ScannerOptions scanner_;
  std::mt19937_64 random_{1};
  ScanArchive archive_;
};

MapView ViewOf(TileTree tiles) {
  MapView view;
  view.options = kOptions;
  view.tiles = std::move(tiles);
  return view;
}

double AucOf(const MapView& map, const std::vector<Vector2d>& hits,
             const std::vector<Vector2d>& free) {
  const auto log_odds = [&](const std::vector<Vector2d>& points_m) {
    std::vector<double> values;
    for (const Vector2d& p : points_m) {
      const SurfaceSample sample = map.Evaluate(p.x(), p.y());
      values.push_back(sample.known ? sample.log_odds : 0);
    }
    return values;
  };
  return Auc(log_odds(hits), log_odds(free));
}

// To two knot intervals, and a door's frame hides its ends.
void ExpectRegion(const Region& region, const Vector2d& low_m, const Vector2d& high_m) {
  EXPECT_NEAR(region.x0_m, low_m.x(), 0.15);
  EXPECT_NEAR(region.y0_m, low_m.y(), 0.1);
  EXPECT_NEAR(region.x1_m, high_m.x(), 0.15);
  EXPECT_NEAR(region.y1_m, high_m.y(), 0.1);
}

TEST(WeekTest, ChangesAreNamedAndWhatIsForgottenWasNeverSeen) {
  Week week;
  for (int day = 0; day < kDays; ++day) week.Drive(day, 9, day % 2 == 0);
  const int today = kDays - 1;
  week.Drive(today, 17, false);

  const MapView now = ViewOf(*FoldArchive(week.archive(), kOptions));
  const ArchiveEdit wind_back = *WindBackTo(week.archive(), Week::TimeOf(2, 12));
  const MapView before = ViewOf(*FoldArchive(wind_back.Apply(week.archive()), kOptions));
  const std::vector<OccupancyChange> changes = OccupancyChanges(before, now);
  for (const OccupancyChange& change : changes) {
    fmt::print("{:<9}{:6.2f},{:.2f} to {:.2f},{:.2f} m, {} control points\n",
               change.is_occupied ? "occupied" : "free", change.region.x0_m, change.region.y0_m,
               change.region.x1_m, change.region.y1_m, change.knots.size());
  }
  // Nobody's way through the corridor is one.
  ASSERT_EQ(changes.size(), 3u);
  EXPECT_FALSE(changes[0].is_occupied);
  ExpectRegion(changes[0].region, kCupboardWas, kCupboardWas + Vector2d(kCupboard_m, kCupboard_m));
  EXPECT_TRUE(changes[1].is_occupied);
  ExpectRegion(changes[1].region, kCupboardIs, kCupboardIs + Vector2d(kCupboard_m, kCupboard_m));
  EXPECT_TRUE(changes[2].is_occupied);
  ExpectRegion(changes[2].region, {2.5, kDoorY_m}, {3.5, kDoorY_m});

  const Utime hour_begins = Week::TimeOf(today, 16);
  const ArchiveEdit forget = *ForgetBefore(week.archive(), hour_begins);
  const TileTree last_hour = *FoldArchive(forget.Apply(week.archive()), kOptions);
  ScanFolder folder(kOptions);
  Layer never_saw_more(LayerId{"robot", 1}, SessionId{1, 1});
  week.archive().ForEach([&](const PosedScan& scan, const BeamModelOptions& model) {
    if (scan.utime < hour_begins) return;
    PlacedScan placed;
    Place(scan, {}, placed);
    folder.Fold(placed, model, never_saw_more);
  });
  EXPECT_TRUE(DifferentTiles(last_hour, never_saw_more.Snapshot().tiles).empty());

  std::vector<Vector2d> hits;
  std::vector<Vector2d> free;
  week.AddTruth(hits, free);
  const double auc_now = AucOf(now, hits, free);
  const double auc_last_hour = AucOf(ViewOf(last_hour), hits, free);
  const double auc_before = AucOf(before, hits, free);
  fmt::print(
      "area under the curve, of what is there now: {:.4f} for the map of the week, {:.4f} "
      "for that of its last hour, {:.4f} for that of before\n",
      auc_now, auc_last_hour, auc_before);
  EXPECT_GT(auc_now, auc_last_hour - 0.002);
  EXPECT_GT(auc_now, auc_before + 0.01);
}

}  // namespace splinemap::week_test
