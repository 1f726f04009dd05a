#include "services/splinemapd/stored_map.h"

#include <algorithm>
#include <string>
#include <utility>

#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/mapping/fold.h"

namespace splinemap {
namespace {

absl::Status CheckMethod(const config::Method& method, const MapOptions& file,
                         const std::string& path) {
  const MapOptions wanted = MapOptionsOf(method);
  const bool asks_for_min = method.has_preset() || method.has_clamp_min();
  const bool asks_for_max = method.has_preset() || method.has_clamp_max();
  const bool fits =
      (!method.has_knot_interval_m() || wanted.knot_interval_m == file.knot_interval_m) &&
      (!asks_for_min || wanted.limits.min == file.limits.min) &&
      (!asks_for_max || wanted.limits.max == file.limits.max);
  if (fits) return absl::OkStatus();
  return FailedPrecondition(
      "{} was made with knot_interval_m {}, clamp_min {} and clamp_max {}, and the configuration "
      "says otherwise; give another file with --map, or these values",
      path, file.knot_interval_m, file.limits.min / double{kUnitsPerLogOdds},
      file.limits.max / double{kUnitsPerLogOdds});
}

// The layer that this daemon continued last; of a file that was built or merged, the one of its
// name. Others of its name are of others.
std::vector<LayerSnapshot>::iterator OwnLayerOf(LayerSet& set, const std::string& name) {
  return std::find_if(set.layers.begin(), set.layers.end(), [&](const LayerSnapshot& layer) {
    return layer.id.name == name && (!set.own_layer || layer.id == *set.own_layer);
  });
}

// Beyond half of what may be said somebody else has counted, and may go on.
bool HasRoomToCount(uint64_t session_number, uint64_t revision) {
  return session_number <= SessionId::kMaxNumber / 2 && revision <= kMaxRevision / 2;
}

void ReportCorruption(const LoadedMap& loaded, const std::string& path, NoticeLog& notices) {
  constexpr size_t kMaxLines = 5;
  const std::vector<std::string>& corruption = loaded.corruption;
  if (corruption.empty()) return;
  std::string text = fmt::format(
      "{}: {} corrupt records were skipped; the next save rewrites the file, and the corrupt one "
      "is "
      "kept as {}",
      path, corruption.size(), loaded.kept_copy);
  for (size_t k = 0; k < std::min(corruption.size(), kMaxLines); ++k) text += "; " + corruption[k];
  notices.Report({.subject = "corruption", .text = std::move(text)});
}

// The layer in the session after its last one, without what was removed.
Layer Continue(const LayerSnapshot& last, const LayerSettings& settings, bool takes_commands,
               NoticeLog& notices) {
  const SessionId next{last.session.number + 1, RandomId()};
  const bool is_removed = settings.IsRemoved(next) && takes_commands;
  const uint64_t number = is_removed ? settings.removed_up_to + 1 : next.number;
  if (HasRoomToCount(number, last.revision)) {
    return is_removed ? Layer(last.id, {number, next.nonce}) : Layer(last, next);
  }
  Layer fresh(LayerId{last.id.name, RandomId()}, {1, next.nonce});
  if (!is_removed) {
    last.tiles.ForEach(
        [&](TileKey key, const TileTree::Entry& entry) { fresh.RestoreTile(key, entry.tile, 1); });
  }
  notices.Report({.subject = "identity",
                  .text = fmt::format(
                      "session {} and commit {} of {} leave no room to count on, so it continues "
                      "as another layer, origin {:016x}; followers that have the layer of origin "
                      "{:016x} add up both: splinemap layer remove removes it",
                      number, last.revision, last.id.name, fresh.id().origin, last.id.origin)});
  return fresh;
}

// Where the configuration says another frame than that of the file, the layer is made anew there.
absl::Status PlaceAt(const FixedPose2& map_T_world, const MapOptions& options,
                     const std::string& path, LayerSnapshot& layer) {
  if (layer.archive->map_T_world == map_T_world) return absl::OkStatus();
  auto archive = std::make_shared<ScanArchive>(*layer.archive);
  archive->map_T_world = map_T_world;
  auto placed = Refolded(layer, std::move(archive), options, layer.session);
  if (!placed.ok()) {
    return FailedPrecondition("{} has another frame than the configuration says: {}", path,
                              ErrorText(placed.status()));
  }
  layer = *std::move(placed);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<StoredMap> LoadStoredMap(const config::Config& config, MapFile& file,
                                        NoticeLog& notices) {
  LayerSet set{.options = MapOptionsOf(config.method())};
  if (const absl::StatusOr<LoadedMap> loaded = file.Load(); !absl::IsNotFound(loaded.status())) {
    SPLINEMAP_RETURN_IF_ERROR(loaded.status());
    ReportCorruption(*loaded, file.path(), notices);
    set = loaded->set;
    SPLINEMAP_RETURN_IF_ERROR(CheckMethod(config.method(), set.options, file.path()));
  }
  const std::string name = RobotName(config);
  const auto own = OwnLayerOf(set, name);
  if (own == set.layers.end()) {
    Layer fresh(LayerId{name, RandomId()}, {1, RandomId()});
    ScanArchive archive;
    archive.map_T_world = FrameOf(config);
    return StoredMap{set.options, std::move(fresh), std::move(archive), std::move(set)};
  }
  if (!config.frame().empty()) {
    SPLINEMAP_RETURN_IF_ERROR(PlaceAt(FrameOf(config), set.options, file.path(), *own));
  }
  Layer layer =
      Continue(*own, set.settings.Of(own->id), config.service().remote_commands(), notices);
  ScanArchive archive;
  if (layer.tiles().size() > 0) archive = *own->archive;
  archive.map_T_world = own->archive->map_T_world;
  set.layers.erase(own);
  return StoredMap{set.options, std::move(layer), std::move(archive), std::move(set)};
}

}  // namespace splinemap
