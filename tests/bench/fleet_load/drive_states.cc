#include "tests/bench/fleet_load/drive_states.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "lib/base/status.h"
#include "lib/fleet/fleet_key.h"
#include "lib/mapping/scan_folder.h"
#include "tests/support/recorded_drive.h"
#include "tests/support/scan_mapper.h"
#include "tests/support/shared_data.h"

namespace splinemap::bench {
namespace {

constexpr double kScansPerS = 10;

}  // namespace

absl::StatusOr<DriveStates> MapDrive(const std::string& log, double interval_s, int32_t squares_x,
                                     int32_t squares_y) {
  const std::optional<std::string> path = SharedData("carmen/" + log);
  if (!path) return NotFound("the shared data folder has no carmen/{}", log);
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<RecordedScan> drive, ReadRecordedDrive(*path, {}));
  DriveStates result{{0.05, {-64 * kUnitsPerLogOdds, 64 * kUnitsPerLogOdds}}, {}, 0};
  const auto folder = std::make_shared<ScanFolder>(result.options);
  ScanMapper mapper(folder);
  Layer layer(LayerId{"drive", 1}, SessionId{1, 1});
  const int64_t scans_per_state = std::max<int64_t>(std::llround(kScansPerS * interval_s), 1);
  TileTree before;
  TileTreeEditor shifted;
  for (const RecordedScan& recorded : drive) {
    mapper.Map(PosedScanOf(recorded), layer);
    ++result.scans;
    if (result.scans % scans_per_state != 0) continue;
    LayerSnapshot state = layer.Snapshot();
    TileTree::ForEachDifference(
        before, state.tiles,
        [&](TileKey key, const TileTree::Entry*, const TileTree::Entry* after) {
          // A copy, since a tile has the checksum of its place.
          shifted.Put({key.tx + squares_x * kSquareSide, key.ty + squares_y * kSquareSide},
                      std::make_shared<StoredTile>(*after->tile->Get()), after->revision);
        });
    before = state.tiles;
    state.tiles = shifted.Freeze();
    result.states.push_back(std::move(state));
  }
  return result;
}

}  // namespace splinemap::bench
