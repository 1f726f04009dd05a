// Layers of recorded drives, placed by another angle: how far walls get from where they were,
// beside maps that were built of turned poses. Prints the figures of lib/map/README.md.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <optional>
#include <string>
#include <vector>

#include "lib/mapping/beam_model.h"
#include "lib/mapping/scan_scratch.h"
#include "tests/bench/accuracy/score.h"
#include "tests/support/map_writer.h"
#include "tests/support/placement.h"
#include "tests/support/recorded_drive.h"
#include "tests/support/shared_data.h"

namespace splinemap::placed_drive_test {

using Eigen::Vector2d;

constexpr ControlLimits kLimits{-64 * kUnitsPerLogOdds, 64 * kUnitsPerLogOdds};

// Of every other scan, with poses of another frame; the layer is placed.
std::shared_ptr<const MapView> Build(const std::vector<RecordedScan>& drive, const Pose2& frame,
                                     const FixedPose2& placement) {
  MapWriter map({0.05, kLimits});
  Layer& layer = map.AddLayer({"robot", 1}, {1, 1});
  BeamModel model({}, map.options().knot_interval_m);
  ScanScratch scratch;
  for (size_t k = 0; k < drive.size(); k += 2) {
    model.Accumulate(Place({drive[k].scan, frame * drive[k].world_T_sensor}), scratch);
    scratch.CommitTo(layer, kLimits);
  }
  SettingsTable settings;
  settings.Merge(layer.id(), {.placement = placement});
  map.SetSettings(settings);
  return map.View();
}

// A map, and where a point of the drive lies in it.
struct MovedMap {
  std::shared_ptr<const MapView> map;
  Pose2 map_T_drive;

  double LogOdds(const Vector2d& point_m) const {
    const Vector2d moved_m = map_T_drive * point_m;
    return map->Evaluate(moved_m.x(), moved_m.y()).log_odds;
  }
  // The first face before or shortly behind the hit of a beam, from the hit on.
  std::optional<double> FaceAt(const Vector2d& hit_m, const Vector2d& direction) const {
    constexpr double kBefore_m = -0.3;
    constexpr double kBehind_m = 0.15;
    constexpr double kStep_m = 0.01;
    if (LogOdds(hit_m + kBefore_m * direction) > 0) return std::nullopt;
    for (double r = kBefore_m + kStep_m; r < kBehind_m; r += kStep_m) {
      if (LogOdds(hit_m + r * direction) <= 0) continue;
      double free_m = r - kStep_m;
      double occupied_m = r;
      while (occupied_m - free_m > 1e-5) {
        const double middle_m = (free_m + occupied_m) / 2;
        (LogOdds(hit_m + middle_m * direction) > 0 ? occupied_m : free_m) = middle_m;
      }
      return free_m;
    }
    return std::nullopt;
  }
};

struct Figures {
  double auc = 0;
  double median_mm = 0;  // between faces here and in the map that they are compared with
  double most_mm = 0;    // of nine in ten
};

// By every fourth beam of the scans that were not mapped.
Figures Compare(const std::vector<RecordedScan>& drive, const MovedMap& map,
                const MovedMap& other) {
  constexpr double kNear_m = 0.5;
  std::vector<double> hits;
  std::vector<double> free;
  std::vector<double> offsets_mm;
  for (size_t k = 1; k < drive.size(); k += 2) {
    const std::vector<PlacedBeam> beams = Place(drive[k]);
    for (size_t n = 0; n < beams.size(); n += 4) {
      const PlacedBeam& beam = beams[n];
      if (beam.range_m < kNear_m) continue;
      const Vector2d hit_m = beam.origin_world_m + beam.range_m * beam.direction_world;
      const double share = static_cast<double>(n % 16) / 16;
      hits.push_back(map.LogOdds(hit_m));
      free.push_back(
          map.LogOdds(beam.origin_world_m + share * (beam.range_m - 0.15) * beam.direction_world));
      const auto face_m = map.FaceAt(hit_m, beam.direction_world);
      const auto other_m = other.FaceAt(hit_m, beam.direction_world);
      if (face_m && other_m) offsets_mm.push_back(1000 * std::abs(*face_m - *other_m));
    }
  }
  EXPECT_GT(offsets_mm.size(), 2000u);
  return {Auc(hits, free), Quantile(offsets_mm, 0.5), Quantile(offsets_mm, 0.9)};
}

TEST(PlacedDriveTest, WallsStayWhereTheyAre) {
  fmt::print("{:<14}{:<22}{:>8}{:>11}{:>14}\n", "drive", "map", "auc", "median_mm", "9_in_10_mm");
  bool is_there = false;
  for (const std::string name : {"intel", "csail", "aces"}) {
    const auto path = SharedData("carmen/" + name + "-corrected.log.gz");
    if (!path) continue;
    is_there = true;
    const std::vector<RecordedScan> drive = *ReadRecordedDrive(*path, {});
    const FixedPose2 placement = PlacedAt(1.013, 2.027, 30);
    const Pose2 pose = placement.ToPose();
    const MovedMap as_mapped{Build(drive, {}, {}), {}};
    const auto figures_of = [&](const char* what, const MovedMap& map) {
      const Figures figures = Compare(drive, map, as_mapped);
      fmt::print("{:<14}{:<22}{:>8.4f}{:>11.2f}{:>14.1f}\n", name, what, figures.auc,
                 figures.median_mm, figures.most_mm);
      return figures;
    };
    const Figures before = figures_of("as it was mapped", as_mapped);
    const Figures placed = figures_of("placed", {Build(drive, {}, placement), pose});
    const Figures of_poses = figures_of("of turned poses", {Build(drive, pose, {}), pose});
    EXPECT_GT(placed.auc, before.auc - 0.001);
    EXPECT_LT(placed.median_mm, 1.5);
    EXPECT_LT(placed.most_mm, 7);
    EXPECT_LT(placed.median_mm, of_poses.median_mm / 2);
  }
  if (!is_there) GTEST_SKIP() << "the shared data folder with recorded drives is not there";
}

}  // namespace splinemap::placed_drive_test
