#include "lib/mapping/fold.h"

#include <algorithm>
#include <utility>

#include "lib/base/status.h"

namespace splinemap {
namespace {

// By their checksums, so that what is not in memory need not be read.
bool IsEqual(TileKey key, const StoredTile& a, const StoredTile* b) {
  if (b == nullptr) return a.Touched().points == 0;
  return &a == b || a.Checksum(key) == b->Checksum(key);
}

}  // namespace

Fold::Fold(const ScanArchive& archive, const MapOptions& options, std::shared_ptr<SpillFile> spill)
    : folder_(options),
      layer_(LayerSnapshot{{}, {}, 0, archive.base.tiles}, {}),
      first_scan_(archive.scans_added() - archive.num_scans()),
      spill_(std::move(spill)) {}

void Fold::Spill() {
  if (layer_.tiles().size() < spill_->memory()->max_tiles() / 2) return;
  const TileTree tiles = Tiles();
  SpillFile::Take(spill_, tiles, spilled_up_to_);
  spilled_up_to_ = tiles.version();
}

absl::Status Fold::Continue(const ScanArchive& archive, const FoldProgress& is_cancelled) {
  const ScanArchive::Base& base = archive.base;
  if (!base.IsEmpty() && base.map_T_world != archive.map_T_world) {
    return FailedPrecondition("{} and cannot be placed anew", NotKept(archive));
  }
  absl::Status status;
  archive.ForEachAfter(first_scan_ + scans_,
                       [&](const PosedScan& scan, const BeamModelOptions& model) {
                         if (!status.ok()) return;
                         Place(scan, archive.map_T_world, placed_);
                         status = folder_.Check(placed_);
                         if (status.ok() && is_cancelled(scans_))
                           status = absl::CancelledError("cancelled");
                         if (!status.ok()) return;
                         folder_.Fold(placed_, model, layer_);
                         constexpr int64_t kScansInMemory = 500;
                         if (++scans_ % kScansInMemory == 0 && spill_ != nullptr) Spill();
                       });
  if (status.ok() && spill_ != nullptr && spill_->has_lost_tiles()) {
    return DataLoss("a tile that was not in memory could not be read again");
  }
  return status;
}

void Shorten(ScanArchive& archive, size_t max_bytes, const MapOptions& options) {
  while (archive.bytes() > max_bytes) {
    const std::shared_ptr<const ScanBlock> oldest = archive.TakeOldest();
    if (oldest == nullptr) return;
    ScanArchive::Base& base = archive.base;
    if (base.IsEmpty()) base.map_T_world = archive.map_T_world;
    ScanFolder folder(options);
    Layer layer(LayerSnapshot{{}, {}, 0, base.tiles}, {});
    PlacedScan placed;
    for (const auto& scan : UnpackScans(*oldest)) {
      Place(*scan, base.map_T_world, placed);
      if (!folder.Check(placed).ok()) continue;  // of a file: it cannot have been mapped
      folder.Fold(placed, oldest->model, layer);
      base.newest = std::max(base.newest, scan->utime);
    }
    base.tiles = layer.Snapshot().tiles;
    base.scans += oldest->num_scans;
  }
}

absl::StatusOr<TileTree> FoldArchive(const ScanArchive& archive, const MapOptions& options) {
  Fold fold(archive, options);
  SPLINEMAP_RETURN_IF_ERROR(fold.Continue(archive));
  return fold.Tiles();
}

std::vector<TileKey> DifferentTiles(const TileTree& a, const TileTree& b) {
  std::vector<TileKey> keys;
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (!IsEqual(key, *entry.tile, b.Find(key))) keys.push_back(key);
  });
  b.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (a.Find(key) == nullptr && !IsEqual(key, *entry.tile, nullptr)) keys.push_back(key);
  });
  return keys;
}

TileTree WithRevisionsOf(const TileTree& old, const TileTree& fresh, uint64_t revision) {
  TileTreeEditor result;
  fresh.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const bool is_old = old.Find(key) != nullptr && IsEqual(key, *entry.tile, old.Find(key));
    result.Put(key, is_old ? old.Share(key) : entry.tile, is_old ? old.RevisionOf(key) : revision);
  });
  return result.Freeze();
}

absl::StatusOr<LayerSnapshot> Refolded(const LayerSnapshot& layer,
                                       std::shared_ptr<const ScanArchive> archive,
                                       const MapOptions& options, SessionId session,
                                       const FoldProgress& is_cancelled) {
  Fold fold(*archive, options);
  SPLINEMAP_RETURN_IF_ERROR(fold.Continue(*archive, is_cancelled));
  LayerSnapshot result{layer.id, session, layer.revision + 1, {}, std::move(archive)};
  result.tiles = WithRevisionsOf(layer.tiles, fold.Tiles(), result.revision);
  return result;
}

absl::Status CheckScansAreKept(const LayerSnapshot& layer) {
  const bool has_scans = layer.archive != nullptr && layer.archive->num_scans() > 0;
  if (has_scans || layer.tiles.size() == 0) return absl::OkStatus();
  return FailedPrecondition("the map keeps no scans of it (max_archive_mb), only tiles");
}

std::string NotKept(const ScanArchive& archive) {
  const int64_t scans = archive.base.scans;
  return fmt::format("{} of the layer are not kept any more (max_archive_mb),",
                     scans > 0 ? fmt::format("the oldest {} scans", scans) : "the oldest scans");
}

}  // namespace splinemap
