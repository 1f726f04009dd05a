#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/mapping/scan_folder.h"
#include "lib/tiles/spill_file.h"
#include "splinemap/layer_set.h"
#include "splinemap/scan_archive.h"

namespace splinemap {

// Is told before each scan how many were folded; true ends the fold.
using FoldProgress = std::function<bool(int64_t scans_folded)>;
inline bool GoOn(int64_t) { return false; }

// Folds archives: layer = fold(archive), the law of layers that keep their scans.
//
// A fold may take long, beside which scans go on to be mapped; Continue() adds what came meanwhile.
// Thread-compatible.
class Fold {
 public:
  // Begins with the base of `archive`. Where `spill` is given, tiles that do not fit into its
  // memory go there.
  Fold(const ScanArchive& archive, const MapOptions& options,
       std::shared_ptr<SpillFile> spill = nullptr);

  // Folds what `archive` has more than what was folded: it is the one that the fold began with,
  // later, and has all of its scans that were not folded.
  // FailedPrecondition where its base was mapped in another place than where the archive has to be
  // now: a base cannot be moved. InvalidArgument for a scan that cannot be folded with these
  // options. Cancelled. DataLoss where `spill` lost something.
  absl::Status Continue(const ScanArchive& archive, const FoldProgress& is_cancelled = GoOn);

  int64_t scans_folded() const { return scans_; }
  TileTree Tiles() { return layer_.Snapshot().tiles; }

 private:
  ScanFolder folder_;
  Layer layer_;
  int64_t first_scan_;
  int64_t scans_ = 0;  // folded
  PlacedScan placed_;

  void Spill();
  const std::shared_ptr<SpillFile> spill_;
  uint64_t spilled_up_to_ = 0;  // version of the tiles
};

// Moves the oldest scans to the base until the archive has `max_bytes` at most. Requires that its
// scans can be folded with these options.
void Shorten(ScanArchive& archive, size_t max_bytes, const MapOptions& options);

// The tiles that an archive makes.
absl::StatusOr<TileTree> FoldArchive(const ScanArchive& archive, const MapOptions& options);

// Whether two trees have equal tiles, those of zeros left out; the keys of those that differ.
std::vector<TileKey> DifferentTiles(const TileTree& a, const TileTree& b);

// `fresh` with the tiles and revisions of `old` where they are equal, and `revision` elsewhere.
TileTree WithRevisionsOf(const TileTree& old, const TileTree& fresh, uint64_t revision);

// The layer of another archive, in another session; its revision counts on.
absl::StatusOr<LayerSnapshot> Refolded(const LayerSnapshot& layer,
                                       std::shared_ptr<const ScanArchive> archive,
                                       const MapOptions& options, SessionId session,
                                       const FoldProgress& is_cancelled = GoOn);

// FailedPrecondition where it has tiles, but no scans that make them.
absl::Status CheckScansAreKept(const LayerSnapshot& layer);

// "the oldest 70 scans of the layer are not kept any more (max_archive_mb),", for errors.
std::string NotKept(const ScanArchive& archive);

}  // namespace splinemap
