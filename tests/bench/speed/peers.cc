#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <octomap/OcTree.h>

#include <cmath>
#include <memory>
#include <vector>

#include "tests/bench/speed/benchmarks.h"
#include "tests/bench/speed/dense_paper_map.h"
#include "tests/bench/speed/insertion.h"

namespace splinemap::bench {
namespace {

constexpr double kRangeMax_m = 30;

struct MrptScan {
  mrpt::obs::CObservation2DRangeScan observation;
  mrpt::poses::CPose3D world_T_sensor;
};

// MRPT's scans are symmetric to the sensor's x axis, so that the pose has to turn.
MrptScan MrptScanOf(const Workload& workload, const RecordedScan& recorded) {
  MrptScan scan;
  scan.observation.resizeScanAndAssign(workload.num_beams, 0, false);
  for (const Beam& beam : recorded.scan.beams) {
    const auto k =
        std::lround((beam.bearing_rad - workload.first_bearing_rad) / workload.bearing_step_rad);
    scan.observation.setScanRange(k, beam.range_m);
    scan.observation.setScanRangeValidity(k, true);
  }
  const double aperture_rad = (workload.num_beams - 1) * workload.bearing_step_rad;
  scan.observation.aperture = static_cast<float>(aperture_rad);
  scan.observation.maxRange = static_cast<float>(kRangeMax_m);
  const Pose2& pose = recorded.world_T_sensor;
  scan.world_T_sensor =
      mrpt::poses::CPose3D(pose.position_m.x(), pose.position_m.y(), 0,
                           pose.yaw_rad + workload.first_bearing_rad + aperture_rad / 2, 0, 0);
  return scan;
}

using MrptMap = mrpt::maps::COccupancyGridMap2D;

std::unique_ptr<MrptMap> MakeMrptMap(const Eigen::AlignedBox2d& bounds_m, bool widening) {
  const Eigen::AlignedBox2f box_m = bounds_m.cast<float>();
  auto map = std::make_unique<MrptMap>(box_m.min().x(), box_m.max().x(), box_m.min().y(),
                                       box_m.max().y(), static_cast<float>(kResolution_m));
  map->insertionOptions.maxDistanceInsertion = static_cast<float>(kRangeMax_m);
  map->insertionOptions.considerInvalidRangesAsFreeSpace = false;
  map->insertionOptions.wideningBeamsWithDistance = widening;
  return map;
}

void RegisterMrpt(const Workload& workload) {
  const auto scans = std::make_shared<std::vector<MrptScan>>();
  for (const RecordedScan& scan : workload.scans) scans->push_back(MrptScanOf(workload, scan));
  for (const bool widening : {false, true}) {
    const auto make = [bounds_m = BoundsOf(workload), widening] {
      return MakeMrptMap(bounds_m, widening);
    };
    benchmark::RegisterBenchmark(
        ("insertion/" + workload.name + (widening ? "/mrpt_widened_beams" : "/mrpt_simple_beams"))
            .c_str(),
        [&workload, scans, make](benchmark::State& state) {
          TimeInsertion(state, workload, make, [&](MrptMap& map, size_t n) {
            map.insertObservation((*scans)[n].observation, (*scans)[n].world_T_sensor);
          });
        });
  }
}

struct OctomapScan {
  octomap::point3d origin_m;
  octomap::Pointcloud hits_m;
};

octomap::point3d ToPoint3d(const Eigen::Vector2d& point_m) {
  return {static_cast<float>(point_m.x()), static_cast<float>(point_m.y()), 0};
}

OctomapScan OctomapScanOf(const RecordedScan& recorded) {
  OctomapScan scan;
  scan.origin_m = ToPoint3d(recorded.world_T_sensor.position_m);
  for (const PlacedBeam& beam : Place(recorded)) {
    scan.hits_m.push_back(ToPoint3d(beam.origin_world_m + beam.range_m * beam.direction_world));
  }
  return scan;
}

void RegisterOctomap(const Workload& workload) {
  const auto scans = std::make_shared<std::vector<OctomapScan>>();
  for (const RecordedScan& scan : workload.scans) scans->push_back(OctomapScanOf(scan));
  const auto make = [] { return std::make_unique<octomap::OcTree>(kResolution_m); };
  benchmark::RegisterBenchmark(
      ("insertion/" + workload.name + "/octomap").c_str(),
      [&workload, scans, make](benchmark::State& state) {
        TimeInsertion(state, workload, make, [&](octomap::OcTree& map, size_t n) {
          const OctomapScan& scan = (*scans)[n];
          map.insertPointCloud(scan.hits_m, scan.origin_m, kRangeMax_m, /*lazy_eval=*/true,
                               /*discretize=*/true);
        });
      });
}

void RegisterPaper(const Workload& workload) {
  const auto make = [bounds_m = BoundsOf(workload)] {
    return std::make_unique<DensePaperMap>(bounds_m);
  };
  benchmark::RegisterBenchmark(
      ("insertion/" + workload.name + "/paper_in_double").c_str(),
      [&workload, make](benchmark::State& state) {
        TimeInsertion(state, workload, make,
                      [&](DensePaperMap& map, size_t n) { map.Insert(workload.scans[n]); });
      });
}

}  // namespace

void RegisterPeers(const Workload& workload) {
  RegisterMrpt(workload);
  RegisterOctomap(workload);
  RegisterPaper(workload);
}

}  // namespace splinemap::bench
