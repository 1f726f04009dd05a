#include "tests/bench/accuracy/door.h"

#include <random>

#include "tests/bench/accuracy/corridor.h"
#include "tests/bench/accuracy/table.h"

namespace splinemap {
namespace {

class Door {
 public:
  explicit Door(const Method& method) : map_(method.make(0.05)) {}

  void See(bool closed) { map_->AddScan(corridor_.Scan(closed, random_)); }

  bool Is(bool closed) {
    size_t agree = 0;
    for (const Eigen::Vector2d& point_m : corridor_.door_points_m()) {
      const double s = map_->LogOdds(point_m);
      agree += closed ? s > 0 : s < 0;
    }
    return 2 * agree > corridor_.door_points_m().size();
  }

  int SeeUntilItIs(bool closed, int limit) {
    int scans = 0;
    while (scans < limit && !Is(closed)) {
      See(closed);
      ++scans;
    }
    return scans;
  }

 private:
  const Corridor corridor_;
  std::unique_ptr<TestedMap> map_;
  std::mt19937_64 random_{1};
};

}  // namespace

DoorScans CountDoorScans(const Method& method, int before, const Effort& effort) {
  Door door(method);
  DoorScans scans;
  for (int n = 0; n < before; ++n) door.See(false);
  scans.until_closed = door.SeeUntilItIs(true, effort.max_door_scans);
  for (int n = 0; n < before; ++n) door.See(true);
  scans.until_open = door.SeeUntilItIs(false, effort.max_door_scans);
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
