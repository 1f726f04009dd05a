#include "lib/mapping/past_map.h"

#include <algorithm>
#include <utility>

#include "lib/base/status.h"
#include "lib/mapping/archive_edit.h"

namespace splinemap {

absl::StatusOr<ArchiveTimes> TimesOf(const LayerSet& set) {
  std::optional<ArchiveTimes> times;
  for (const LayerSnapshot& layer : set.layers) {
    if (layer.archive == nullptr) continue;
    layer.archive->ForEachPose([&](const ScanPose& pose) {
      if (!times) times = ArchiveTimes{pose.utime, pose.utime};
      times->first = std::min(times->first, pose.utime);
      times->last = std::max(times->last, pose.utime);
    });
  }
  if (!times) return NotFound("the map keeps no scans, so it has no times");
  return *times;
}

PastMap::PastMap(LayerSet now) : now_(std::move(now)), folds_(now_.layers.size()) {
  for (size_t k = 0; k < folds_.size(); ++k) {
    if (now_.layers[k].archive == nullptr) continue;
    now_.layers[k].archive->ForEachPose(
        [&](const ScanPose& pose) { folds_[k].utimes.push_back(pose.utime); });
  }
}

absl::StatusOr<LayerSet> PastMap::At(Utime utime, const PastMapProgress& is_cancelled) {
  LayerSet then = now_;
  int64_t scans = 0;
  for (const LayerFold& made : folds_) scans += made.ScansUntil(utime);
  int64_t folded_before = 0;
  for (size_t k = 0; k < folds_.size(); ++k) {
    const absl::Status status = FoldLayer(then.layers[k], folds_[k], utime, [&](int64_t folded) {
      return is_cancelled(folded_before + folded, scans);
    });
    if (absl::IsCancelled(status)) return status;
    if (!status.ok()) {
      return absl::Status(status.code(),
                          fmt::format("layer {}: {}", then.layers[k].id.name, ErrorText(status)));
    }
    folded_before += folds_[k].ScansUntil(utime);
  }
  return then;
}

absl::Status PastMap::FoldLayer(LayerSnapshot& layer, LayerFold& made, Utime utime,
                                const FoldProgress& is_cancelled) const {
  SPLINEMAP_RETURN_IF_ERROR(CheckScansAreKept(layer));
  if (made.utimes.empty()) return absl::OkStatus();
  SPLINEMAP_ASSIGN_OR_RETURN(const ArchiveEdit edit, WindBackTo(*layer.archive, utime));
  const auto archive = std::make_shared<ScanArchive>(edit.Apply(*layer.archive));
  if (!made.fold || !made.IsPartOf(utime)) made.fold.emplace(*archive, now_.options);
  made.until = utime;
  SPLINEMAP_RETURN_IF_ERROR(made.fold->Continue(*archive, is_cancelled));
  ++layer.revision;
  layer.tiles = WithRevisionsOf(layer.tiles, made.fold->Tiles(), layer.revision);
  layer.archive = archive;
  return absl::OkStatus();
}

int64_t PastMap::LayerFold::ScansUntil(Utime utime) const {
  return std::count_if(utimes.begin(), utimes.end(), [&](Utime scan) { return scan <= utime; });
}

// Whether the scans that were folded are the first of those until `utime`, in the order of mapping,
// which need not be that of time.
bool PastMap::LayerFold::IsPartOf(Utime utime) const {
  int64_t left = fold->scans_folded();
  for (auto scan = utimes.begin(); left > 0; ++scan) {
    if ((*scan <= until) != (*scan <= utime)) return false;
    if (*scan <= until) --left;
  }
  return true;
}

}  // namespace splinemap
