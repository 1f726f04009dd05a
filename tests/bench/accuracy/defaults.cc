#include "tests/bench/accuracy/defaults.h"

#include "tests/bench/accuracy/door.h"
#include "tests/bench/accuracy/rooms.h"
#include "tests/bench/accuracy/score.h"
#include "tests/bench/accuracy/table.h"

namespace splinemap {
namespace {

constexpr int kDoorScansBefore = 100;

double MeanFig3Error(const Method& method, const Effort& effort) {
  double sum = 0;
  for (const double half_side_m : kFig3HalfSides_m) {
    sum += RoomError(method, SquareRoom(half_side_m), 0, effort.room_scans, 1);
  }
  return sum / static_cast<double>(kFig3HalfSides_m.size());
}

}  // namespace

void WriteDefaults(const std::vector<Method>& methods, const std::vector<JudgedDrive>& drives,
                   const Effort& effort, const std::string& out) {
  Table table(out + "/defaults.csv",
              {"method", "drive", "fig3_error", "fig5_error", "scans_until_closed",
               "scans_until_open", "bytes", "auc", "auc_near", "log_likelihood"});
  for (const Method& method : methods) {
    const double fig3 = MeanFig3Error(method, effort);
    const double fig5 =
        Quantile(CircleErrors(method, 0.05, effort.room_scans, effort.default_runs), 0.5);
    const DoorScans door = CountDoorScans(method, kDoorScansBefore, effort);
    for (const JudgedDrive& drive : drives) {
      const std::unique_ptr<TestedMap> map = MapDrive(method, drive, 0.05);
      const Judgement judgement = Judge(*map, drive);
      table.Row(method.name, drive.name, fig3, fig5, door.until_closed, door.until_open,
                map->Bytes(), judgement.auc, judgement.auc_near, judgement.log_likelihood);
    }
  }
}

}  // namespace splinemap
