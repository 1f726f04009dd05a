#pragma once

#include <memory>
#include <utility>

#include "lib/archive/scan_record.h"
#include "lib/mapping/scan_folder.h"
#include "lib/replication/recent_scans.h"
#include "splinemap/layer_set.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// Maps scans into a layer and keeps them, as daemons do. Thread-compatible.
class ScanMapper {
 public:
  // `folder` may be shared.
  explicit ScanMapper(std::shared_ptr<ScanFolder> folder) : folder_(std::move(folder)) {}

  // As owners send it before it is mapped.
  static SentScan SentOf(const PosedScan& scan, const Layer& layer) {
    return {layer.revision() + 1, scan.utime, scan.world_T_robot, PackBeams(scan, {})};
  }

  void Map(const PosedScan& scan, Layer& layer) {
    Place(scan, archive_.map_T_world, placed_);
    folder_->Fold(placed_, {}, layer);
    archive_.Add(std::make_shared<PosedScan>(scan), {});
  }

  LayerSnapshot SnapshotOf(Layer& layer) const {
    LayerSnapshot snapshot = layer.Snapshot();
    snapshot.archive = std::make_shared<ScanArchive>(archive_);
    return snapshot;
  }

 private:
  std::shared_ptr<ScanFolder> folder_;
  ScanArchive archive_;
  PlacedScan placed_;
};

}  // namespace splinemap
