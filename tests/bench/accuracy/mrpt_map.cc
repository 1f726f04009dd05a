#include "tests/bench/accuracy/mrpt_map.h"

#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>

#include <cmath>
#include <numbers>

namespace splinemap {
namespace {

using mrpt::maps::COccupancyGridMap2D;
using mrpt::obs::CObservation2DRangeScan;

constexpr int kBearings = 720;
constexpr double kTurn_rad = 2 * std::numbers::pi;

double Bearing(const PlacedBeam& beam) {
  return std::atan2(beam.direction_world.y(), beam.direction_world.x());
}

// The beams as a full turn of the sensor from the first one on.
CObservation2DRangeScan FullTurn(absl::Span<const PlacedBeam> beams) {
  CObservation2DRangeScan scan;
  scan.aperture = static_cast<float>(kTurn_rad);
  scan.rightToLeft = true;
  scan.maxRange = 100;
  scan.resizeScan(kBearings);
  for (int k = 0; k < kBearings; ++k) scan.setScanRangeValidity(k, false);
  for (const PlacedBeam& beam : beams) {
    if (!beam.hit) continue;
    const double turned = (Bearing(beam) - Bearing(beams.front())) / kTurn_rad;
    const auto k = std::lround((turned - std::floor(turned)) * kBearings) % kBearings;
    scan.setScanRange(k, static_cast<float>(beam.range_m));
    scan.setScanRangeValidity(k, true);
  }
  return scan;
}

class MrptMap : public TestedMap {
 public:
  MrptMap(double resolution_m, double free_probability)
      : TestedMap(COccupancyGridMap2D::OCCGRID_CELLTYPE_MAX / 16.0),
        map_(-1, 1, -1, 1, static_cast<float>(resolution_m)) {
    map_.insertionOptions.maxOccupancyUpdateCertainty = static_cast<float>(free_probability);
    map_.insertionOptions.considerInvalidRangesAsFreeSpace = false;
    map_.insertionOptions.maxDistanceInsertion = 100;
  }

  void AddScan(absl::Span<const PlacedBeam> beams) override {
    if (beams.empty()) return;
    // A scan of MRPT begins half its aperture clockwise of where the sensor looks.
    const Eigen::Vector2d& p = beams.front().origin_world_m;
    const mrpt::poses::CPose3D pose(p.x(), p.y(), 0, Bearing(beams.front()) + std::numbers::pi, 0,
                                    0);
    map_.insertObservation(FullTurn(beams), pose);
  }

  double LogOdds(const Eigen::Vector2d& point_m) override {
    const double free =
        map_.getPos(static_cast<float>(point_m.x()), static_cast<float>(point_m.y()));
    return std::log((1 - free) / free);
  }

  int64_t Bytes() const override {
    return static_cast<int64_t>(map_.getRawMap().size() * sizeof(COccupancyGridMap2D::cellType));
  }

 private:
  COccupancyGridMap2D map_;
};

}  // namespace

Method MrptMethod(const std::string& name, double free_probability) {
  return {name, [=](double resolution_m) {
            return std::make_unique<MrptMap>(resolution_m, free_probability);
          }};
}

}  // namespace splinemap
