#include "lib/layers/layer_union.h"

#include <algorithm>
#include <utility>

#include "lib/base/status.h"

namespace splinemap {
namespace {

bool HasEqualTiles(const LayerSnapshot& a, const LayerSnapshot& b) {
  if (a.tiles.size() != b.tiles.size()) return false;
  bool is_equal = true;
  a.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const StoredTile* other = b.tiles.Find(key);
    is_equal = is_equal && other != nullptr && HaveEqualContent(*other, *entry.tile);
  });
  return is_equal;
}

}  // namespace

LayerSnapshot Merge(const LayerSnapshot& a, const LayerSnapshot& b, int64_t& conflicting_tiles) {
  if (a.session != b.session) return a.session < b.session ? b : a;
  TileTreeEditor tiles(a.tiles);
  b.tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const StoredTile* tile = a.tiles.Find(key);
    if (tile != nullptr) {
      const uint64_t revision = a.tiles.RevisionOf(key);
      const bool is_contradiction =
          revision == entry.revision && !HaveEqualContent(*tile, *entry.tile);
      conflicting_tiles += is_contradiction ? 1 : 0;
      if (revision > entry.revision) return;
      if (revision == entry.revision &&
          tile->Get()->control_points >= entry.tile->Get()->control_points) {
        return;
      }
    }
    tiles.Put(key, entry.tile, entry.revision);
  });
  LayerSnapshot merged{a.id, a.session, std::max(a.revision, b.revision), tiles.Freeze()};
  // The scans of the one that has all of these tiles, if there is one, are what they are made of.
  for (const LayerSnapshot* one : {&a, &b}) {
    if (merged.archive == nullptr && HasEqualTiles(*one, merged)) merged.archive = one->archive;
  }
  return merged;
}

absl::StatusOr<std::vector<LayerUnion::Conflict>> LayerUnion::Add(const LayerSet& map) {
  SettingsTable settings = settings_;
  settings.Merge(map.settings);
  for (const auto& [id, setting] : map.settings.records()) {
    if (Merge(settings.Of(id), setting) == settings.Of(id)) continue;
    return FailedPrecondition("there are records about more than {} layers", SettingsTable::kMax);
  }
  settings_ = std::move(settings);

  std::vector<Conflict> conflicts;
  for (const LayerSnapshot& layer : map.layers) {
    const auto [known, is_new] = layers_.try_emplace(layer.id, layer);
    if (is_new) continue;
    const auto [dropped, kept] = std::minmax(known->second.session, layer.session);
    Conflict conflict{layer.id, kept, dropped, known->second.session < layer.session};
    known->second = Merge(known->second, layer, conflict.conflicting_tiles);
    if (conflict.kept != conflict.dropped || conflict.conflicting_tiles > 0)
      conflicts.push_back(conflict);
  }
  return conflicts;
}

std::vector<LayerId> LayerUnion::Removed() const {
  std::vector<LayerId> removed;
  for (const auto& [id, layer] : layers_) {
    if (settings_.Of(id).IsRemoved(layer.session)) removed.push_back(id);
  }
  return removed;
}

LayerSet LayerUnion::Layers() const {
  LayerSet set{.options = options_};
  for (const auto& [id, layer] : layers_) {
    if (!settings_.Of(id).IsRemoved(layer.session)) set.layers.push_back(layer);
  }
  set.settings = settings_;
  return set;
}

}  // namespace splinemap
