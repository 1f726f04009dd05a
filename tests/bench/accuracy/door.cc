#include "tests/bench/accuracy/door.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "tests/bench/accuracy/table.h"

namespace splinemap {
namespace {

using Eigen::Vector2d;

struct Wall {
  Vector2d from_m;
  Vector2d to_m;
};

const Wall kDoor{{-0.45, 1}, {0.45, 1}};

// A corridor from end to end, 2 m wide, with a room behind the door.
const std::vector<Wall> kWalls = {
    {{-6, -1}, {6, -1}}, {{-6, -1}, {-6, 1}},    {{6, -1}, {6, 1}},     {{-6, 1}, {-0.45, 1}},
    {{0.45, 1}, {6, 1}}, {{-2.5, 1}, {-2.5, 5}}, {{-2.5, 5}, {2.5, 5}}, {{2.5, 1}, {2.5, 5}},
};

// From the origin to the wall; infinity where it is not hit.
double RangeTo(const Wall& wall, const Vector2d& direction) {
  // r direction = from + share (to - from)
  Eigen::Matrix2d a;
  a << direction, wall.from_m - wall.to_m;
  const Vector2d range_and_share = a.inverse() * wall.from_m;
  const bool hit =
      range_and_share(0) > 0 && range_and_share(1) >= 0 && range_and_share(1) <= 1;  // not if NaN
  return hit ? range_and_share(0) : std::numeric_limits<double>::infinity();
}

class Corridor {
 public:
  explicit Corridor(const Method& method) : map_(method.make(0.05)) {
    for (int k = 0; k < 360; ++k) {
      const double bearing_rad = k * std::numbers::pi / 180;
      const Vector2d direction(std::cos(bearing_rad), std::sin(bearing_rad));
      double range_m = std::numeric_limits<double>::infinity();
      for (const Wall& wall : kWalls) range_m = std::min(range_m, RangeTo(wall, direction));
      const double door_m = RangeTo(kDoor, direction);
      open_.push_back({Vector2d::Zero(), direction, range_m, true});
      closed_.push_back({Vector2d::Zero(), direction, std::min(range_m, door_m), true});
      if (door_m < range_m) door_points_m_.push_back(door_m * direction);
    }
  }

  void See(bool closed) {
    std::vector<PlacedBeam> beams = closed ? closed_ : open_;
    for (PlacedBeam& beam : beams) beam.range_m += noise_m_(random_);
    map_->AddScan(beams);
  }

  bool DoorIs(bool closed) {
    size_t agree = 0;
    for (const Vector2d& point_m : door_points_m_) {
      const double s = map_->LogOdds(point_m);
      agree += closed ? s > 0 : s < 0;
    }
    return 2 * agree > door_points_m_.size();
  }

  int SeeUntilDoorIs(bool closed, int limit) {
    int scans = 0;
    while (scans < limit && !DoorIs(closed)) {
      See(closed);
      ++scans;
    }
    return scans;
  }

 private:
  std::unique_ptr<TestedMap> map_;
  std::mt19937_64 random_{1};
  std::normal_distribution<double> noise_m_{0, 0.01};
  std::vector<PlacedBeam> open_;
  std::vector<PlacedBeam> closed_;
  std::vector<Vector2d> door_points_m_;  // where the beams hit it
};

}  // namespace

DoorScans CountDoorScans(const Method& method, int before, const Effort& effort) {
  Corridor corridor(method);
  DoorScans scans;
  for (int n = 0; n < before; ++n) corridor.See(false);
  scans.until_closed = corridor.SeeUntilDoorIs(true, effort.max_door_scans);
  for (int n = 0; n < before; ++n) corridor.See(true);
  scans.until_open = corridor.SeeUntilDoorIs(false, effort.max_door_scans);
  return scans;
}

void WriteDoor(const std::vector<Method>& methods, const Effort& effort, const std::string& out) {
  Table table(out + "/door.csv",
              {"method", "scans_before", "scans_until_closed", "scans_until_open"});
  for (const Method& method : methods) {
    for (const int before : {10, 100, 1000}) {
      if (before > effort.max_door_scans) continue;
      const DoorScans scans = CountDoorScans(method, before, effort);
      table.Row(method.name, before, scans.until_closed, scans.until_open);
    }
  }
}

}  // namespace splinemap
