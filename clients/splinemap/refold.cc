#include "clients/splinemap/refold.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/progress.h"
#include "clients/splinemap/time_flag.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/mapping/fold.h"
#include "lib/mapping/past_map.h"

namespace splinemap {
namespace {

absl::StatusOr<std::vector<LayerId>> LayersToFold(const LayerSet& set,
                                                  const std::vector<std::string>& names) {
  std::vector<LayerId> layers;
  for (const LayerSnapshot& layer : set.layers) layers.push_back(layer.id);
  if (names.empty()) return layers;
  std::vector<LayerId> found;
  for (const std::string& name : names) {
    SPLINEMAP_ASSIGN_OR_RETURN(found.emplace_back(), FindLayer(layers, name, "the map"));
  }
  return found;
}

absl::Status RefoldLayer(LayerSnapshot& layer, EditOf edit_of, const MapOptions& before,
                         const MapOptions& options) {
  SPLINEMAP_RETURN_IF_ERROR(CheckScansAreKept(layer));
  if (layer.archive == nullptr || layer.archive->num_scans() == 0) return absl::OkStatus();
  SPLINEMAP_ASSIGN_OR_RETURN(const ArchiveEdit edit, edit_of(*layer.archive));
  auto archive = std::make_shared<ScanArchive>(edit.Apply(*layer.archive));
  if (options != before && !archive->base.IsEmpty()) {
    return FailedPrecondition(
        "its oldest scans are not kept any more, only their tiles, which have knots {} m apart; "
        "leave them out with --from",
        before.knot_interval_m);
  }
  ProgressBar bar("making " + layer.id.name);
  const auto scans = static_cast<double>(std::max<int64_t>(archive->num_scans(), 1));
  const SessionId session{layer.session.number + 1, RandomId()};
  SPLINEMAP_ASSIGN_OR_RETURN(layer, Refolded(layer, archive, options, session, [&](int64_t done) {
                               bar.Show(static_cast<double>(done) / scans);
                               return false;
                             }));
  return absl::OkStatus();
}

}  // namespace

absl::Status Refold(LayerSet& set, const std::vector<std::string>& names, EditOf edit_of,
                    const std::optional<MapOptions>& options) {
  const MapOptions before = set.options;
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<LayerId> ids, LayersToFold(set, names));
  set.options = options.value_or(before);
  for (LayerSnapshot& layer : set.layers) {
    if (std::find(ids.begin(), ids.end(), layer.id) == ids.end()) continue;
    if (const absl::Status status = RefoldLayer(layer, edit_of, before, set.options); !status.ok())
      return absl::Status(status.code(),
                          fmt::format("layer {}: {}", layer.id.name, ErrorText(status)));
  }
  return absl::OkStatus();
}

absl::Status WindBack(LayerSet& set, const std::string& time) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Utime utime, ParseTime(time, set));
  ProgressBar bar("making the map of then");
  const auto show = [&](int64_t folded, int64_t scans) {
    bar.Show(static_cast<double>(folded) / static_cast<double>(scans));
    return false;
  };
  SPLINEMAP_ASSIGN_OR_RETURN(set, PastMap(std::move(set)).At(utime, show));
  return absl::OkStatus();
}

}  // namespace splinemap
