#include "tests/bench/speed/workload.h"

#include <algorithm>
#include <cstdio>
#include <numbers>
#include <optional>
#include <random>

#include "lib/simulation/simulation.h"
#include "tests/support/shared_data.h"

namespace splinemap::bench {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

struct Recording {
  const char* name;
  const char* file;
  int num_beams;
  double bearing_step_rad;
};

constexpr Recording kRecordings[] = {
    {"intel", "carmen/intel-corrected.log.gz", 180, kDegree},
    {"freiburg_079", "carmen/freiburg-079-corrected.log.gz", 360, kDegree / 2},
    {"csail", "carmen/csail-corrected.log.gz", 361, kDegree / 2},
    {"aces", "carmen/aces-corrected.log.gz", 180, kDegree},
    {"belgioioso", "carmen/belgioioso-corrected.log.gz", 361, kDegree / 2},
};

struct Lidar {
  const char* name;
  ScannerOptions options;
  double scans_per_s;
  bool in_millimetres = false;  // as most scanners say, else noise to the last bit
};

// The paper's, and a large one.
constexpr Lidar kLidars[] = {
    {"simulated_360_beams_3.5_m", {.num_beams = 360, .range_max_m = 3.5}, 5},
    {"simulated_1440_beams_25_m", {.num_beams = 1440, .range_max_m = 25}, 10},
    {"simulated_1440_beams_25_m_in_mm", {.num_beams = 1440, .range_max_m = 25}, 10, true},
};

std::optional<Workload> Load(const Recording& recording, int max_scans) {
  const auto path = SharedData(recording.file);
  if (!path) {
    std::fprintf(stderr, "%s is left out: the shared data folder is not there\n", recording.name);
    return std::nullopt;
  }
  auto drive = ReadRecordedDrive(*path, {});
  if (!drive.ok()) {
    std::fprintf(stderr, "%s is left out: %s\n", recording.name, drive.status().ToString().c_str());
    return std::nullopt;
  }
  if (drive->size() > static_cast<size_t>(max_scans)) drive->resize(max_scans);
  return Workload{recording.name, recording.num_beams, -90 * kDegree, recording.bearing_step_rad,
                  std::move(*drive)};
}

RangeReadings Measure(const simulation::World& world, double time_s, const Pose2& pose,
                      const ScannerOptions& options, std::mt19937_64& random) {
  RangeReadings readings;
  readings.ranges_m = SimulateScan(world, time_s, pose, options, random);
  for (int k = 0; k < options.num_beams; ++k) {
    readings.bearings_rad.push_back(
        static_cast<float>(options.FirstBearing() + k * options.BearingStep()));
  }
  return readings;
}

Workload Simulate(const Lidar& lidar, int max_scans) {
  Workload workload{lidar.name,
                    lidar.options.num_beams,
                    lidar.options.FirstBearing(),
                    lidar.options.BearingStep(),
                    {}};
  const simulation::World world = OfficeFloor();
  const Drive drive = *Drive::Plan(world);
  std::mt19937_64 random(1);
  const auto scans = std::min(max_scans, static_cast<int>(drive.duration_s() * lidar.scans_per_s));
  for (int n = 0; n < scans; ++n) {
    const double time_s = n / lidar.scans_per_s;
    const Pose2 pose = drive.PoseAt(time_s);
    RangeReadings readings = Measure(world, time_s, pose, lidar.options, random);
    for (float& range_m : readings.ranges_m) {
      if (lidar.in_millimetres) range_m = static_cast<float>(std::round(1e3 * range_m) * 1e-3);
    }
    workload.scans.push_back({*PrepareScan(readings, {}, 0), pose});
  }
  return workload;
}

}  // namespace

std::optional<Workload> MakeWorkload(const std::string& name, int max_scans) {
  for (const Recording& recording : kRecordings) {
    if (name == recording.name) return Load(recording, max_scans);
  }
  for (const Lidar& lidar : kLidars) {
    if (name == lidar.name) return Simulate(lidar, max_scans);
  }
  std::fprintf(stderr, "there is no workload %s\n", name.c_str());
  return std::nullopt;
}

Eigen::AlignedBox2d BoundsOf(const Workload& workload) {
  Eigen::AlignedBox2d bounds;
  for (const RecordedScan& scan : workload.scans) {
    for (const PlacedBeam& beam : Place(scan)) {
      bounds.extend(beam.origin_world_m);
      bounds.extend(beam.origin_world_m + beam.range_m * beam.direction_world);
    }
  }
  const Eigen::Vector2d margin_m(1, 1);
  return {bounds.min() - margin_m, bounds.max() + margin_m};
}

}  // namespace splinemap::bench
