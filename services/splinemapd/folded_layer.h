#pragma once

#include <utility>

#include "lib/mapping/archive_edit.h"
#include "lib/mapping/fold.h"

namespace splinemap {

// A layer that is made anew while the present one goes on. Thread-compatible.
class FoldedLayer {
 public:
  // What `edit` makes of `archive`, that of a layer in `session`.
  FoldedLayer(SessionId session, ArchiveEdit edit, const ScanArchive& archive,
              const MapOptions& options, std::shared_ptr<SpillFile> spill = nullptr)
      : session_(session),
        edit_(std::move(edit)),
        scans_added_(archive.scans_added()),
        archive_(edit_.Apply(archive)),
        fold_(archive_, options, std::move(spill)) {}

  SessionId session() const { return session_; }
  // Of the present layer, so many are here.
  int64_t scans_added() const { return scans_added_; }
  const ScanArchive& archive() const { return archive_; }

  // Whether Append() can take all: none of it has gone to the base meanwhile.
  bool CanAppend(const ScanArchive& archive) const {
    return archive.scans_added() - archive.num_scans() <= scans_added_;
  }
  // Takes what `archive` has more by now.
  void Append(const ScanArchive& archive) {
    archive.ForEachAfter(scans_added_, [&](const PosedScan& scan, const BeamModelOptions& model) {
      if (auto edited = edit_.ApplyTo(scan)) archive_.Add(std::move(edited), model);
    });
    scans_added_ = archive.scans_added();
  }
  absl::Status Fold(const FoldProgress& is_cancelled = GoOn) {
    return fold_.Continue(archive_, is_cancelled);
  }
  TileTree Tiles() { return fold_.Tiles(); }

 private:
  const SessionId session_;
  const ArchiveEdit edit_;
  int64_t scans_added_;
  ScanArchive archive_;
  splinemap::Fold fold_;
};

}  // namespace splinemap
