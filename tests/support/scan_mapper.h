#pragma once

#include <memory>
#include <utility>

#include "lib/mapping/scan_folder.h"
#include "splinemap/layer_set.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// Maps scans into a layer and keeps them, as daemons do. Thread-compatible.
class ScanMapper {
 public:
  // `folder` may be shared.
  explicit ScanMapper(std::shared_ptr<ScanFolder> folder) : folder_(std::move(folder)) {}

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
