#include "clients/splinemap/fleet_scans.h"

#include <algorithm>
#include <memory>

#include "absl/cleanup/cleanup.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "lib/base/file.h"
#include "lib/base/host_clock.h"
#include "lib/base/status.h"
#include "lib/fleet/nats_fleet_store.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

std::string TextOf(std::chrono::duration<double> age) {
  const double s = age.count();
  if (s < 120) return fmt::format("{:.0f} s", s);
  if (s < 2 * 3600) return fmt::format("{:.0f} min", s / 60);
  if (s < 2 * 86'400) return fmt::format("{:.0f} h", s / 3600);
  return fmt::format("{:.0f} days", s / 86'400);
}

// Writes the copy to `path`.
absl::StatusOr<FleetFile> Fetch(FleetStore& files, const LayerId& id, const std::string& path) {
  constexpr int kAttempts = 3;  // robots bring files at intervals of minutes
  for (int k = 0; k < kAttempts; ++k) {
    SPLINEMAP_ASSIGN_OR_RETURN(const FleetFile before, FindFleetFile(files, id));
    MapFile::Remove(path);
    const absl::Status got = GetFleetFile(files, id, path);
    SPLINEMAP_ASSIGN_OR_RETURN(const FleetFile after, FindFleetFile(files, id));
    if (after.utime != before.utime) continue;  // a later copy has taken its place meanwhile
    SPLINEMAP_RETURN_IF_ERROR(got);
    return after;
  }
  return DataLoss("later copies of the map file of {} took its place while it was read", id.name);
}

absl::StatusOr<LayerSnapshot> ReadLayer(const std::string& path, const LayerId& id,
                                        const LayerSet& fleet) {
  const absl::StatusOr<LoadedMap> file = ReadMapFile(path);
  if (!file.ok()) return DataLoss("its map file is damaged");
  if (!file->corruption.empty()) {
    return DataLoss("its map file is damaged: {}", file->corruption.front());
  }
  if (file->set.options != fleet.options) {
    return FailedPrecondition("its map file has another knot interval or other clamps");
  }
  const LayerSnapshot* const layer = file->set.Find(id);
  if (layer == nullptr) return FailedPrecondition("its map file does not have this layer");
  if (fleet.settings.Of(id).IsRemoved(layer->session)) {
    return FailedPrecondition("its map file is from before the layer was removed");
  }
  if (layer->archive == nullptr || layer->archive->num_scans() == 0) {
    return FailedPrecondition("its map file keeps none (max_archive_mb), or did not have one yet");
  }
  return *layer;
}

// The layer with scans in place of `layer`; what there is to say of it.
absl::StatusOr<std::string> TakeScansOf(FleetStore& files, const LayerSet& fleet,
                                        const std::string& path, LayerSnapshot& layer) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FleetFile copy, Fetch(files, layer.id, path));
  SPLINEMAP_ASSIGN_OR_RETURN(LayerSnapshot own, ReadLayer(path, layer.id, fleet));
  const uint64_t behind = layer.revision - std::min(layer.revision, own.revision);
  const bool is_earlier = own.session < layer.session;
  layer = std::move(own);
  return fmt::format("{} scans, copied {} ago, {} commits behind the fleet's tiles{}",
                     layer.archive->num_scans(), TextOf(AgeOf(copy)), behind,
                     is_earlier ? ", of an earlier session" : "");
}

}  // namespace

std::chrono::duration<double> AgeOf(const FleetFile& file) {
  const int64_t now = HostUtime();
  return std::chrono::microseconds(now - std::clamp<int64_t>(file.utime, 0, now));
}

absl::StatusOr<int> TakeScans(const FleetAddress& fleet, const std::string& out, LayerSet& map) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto files, NatsFleetStore::Connect(FilesOf(fleet)));
  int exit_status = kSuccess;
  for (LayerSnapshot& layer : map.layers) {
    const std::string path = TemporaryPathFor(out);
    const absl::Cleanup remove_copy = [&] { MapFile::Remove(path); };
    const absl::StatusOr<std::string> taken = TakeScansOf(*files, map, path, layer);
    const absl::StatusCode code = taken.status().code();
    if (taken.ok()) {
      PrintLine(stderr, "{}: {}", layer.id.name, *taken);
    } else if (code == absl::StatusCode::kOutOfRange) {
      PrintLine(stderr, "{}: no scans, its robot brings no map file (splinemap-uplink --map)",
                layer.id.name);
    } else if (code == absl::StatusCode::kDataLoss ||
               code == absl::StatusCode::kFailedPrecondition) {
      PrintLine(stderr, "{}: no scans, {}", layer.id.name, ErrorText(taken.status()));
      exit_status = kFailed;
    } else {
      return taken.status();
    }
  }
  return exit_status;
}

}  // namespace splinemap
