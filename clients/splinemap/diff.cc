#include <algorithm>
#include <cstdio>
#include <memory>
#include <set>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/say.h"
#include "lib/base/status.h"
#include "lib/map/summed_layers.h"
#include "lib/store/map_file.h"

namespace splinemap {
namespace {

struct Difference {
  int64_t tiles = 0;
  int64_t control_points = 0;
};

// An absent tile equals one of zeros.
Difference Compare(const TileTree& a, const TileTree& b) {
  static const Tile kZeros;
  Difference difference;
  const auto compare = [&](const Tile& x, const Tile& y) {
    if (x == y) return;
    ++difference.tiles;
    for (int k = 0; k < Tile::kSize; ++k) {
      difference.control_points += x.control_points[k] != y.control_points[k];
    }
  };
  a.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    const Tile* other = b.Find(key);
    compare(*entry.tile, other == nullptr ? kZeros : *other);
  });
  b.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (a.Find(key) == nullptr) compare(*entry.tile, kZeros);
  });
  return difference;
}

bool Has(const std::vector<LayerSnapshot>& layers, const LayerId& id) {
  return std::any_of(layers.begin(), layers.end(),
                     [&](const LayerSnapshot& layer) { return layer.id == id; });
}

// The layer of `layers` that answers to `id` of `others`: the same one, or else one of its name
// that is not taken and no other's very own, since two builds of one robot differ in their origin.
const LayerSnapshot* Counterpart(const LayerId& id, const std::vector<LayerSnapshot>& others,
                                 const std::vector<LayerSnapshot>& layers,
                                 const std::set<const LayerSnapshot*>& taken) {
  const LayerSnapshot* of_that_name = nullptr;
  for (const LayerSnapshot& layer : layers) {
    if (layer.id == id) return &layer;
    const bool is_free = !taken.contains(&layer) && !Has(others, layer.id);
    if (layer.id.name == id.name && is_free) of_that_name = &layer;
  }
  return of_that_name;
}

// What was set about a layer, as far as it matters for the sum.
std::string SettingsText(const LayerSettings& setting) {
  LayerSettings of_the_sum = setting;
  of_the_sum.removed_up_to = 0;
  const std::string text = TextOf(of_the_sum, std::nullopt);
  return text.empty() ? "summed as it is" : text;
}

// Layers of which only one of the maps knows that they were removed: the maps are equal, and what
// will be merged with them need not be.
void ReportRemovals(const LayerSet& map, const LayerSet& other, const std::string& path) {
  for (const auto& [id, setting] : map.settings.records()) {
    if (setting.removed_up_to <= other.settings.Of(id).removed_up_to) continue;
    Say(stdout, "layer {}: removed up to session {}, only in {}", NameOf(id), setting.removed_up_to,
        path);
  }
}

absl::StatusOr<int> Diff(const std::string& path_a, const std::string& path_b) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded_a, ReadMapFile(path_a));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded_b, ReadMapFile(path_b));
  const LayerSet& a = loaded_a.set;
  const LayerSet& b = loaded_b.set;
  bool equal = true;
  for (const LoadedMap* loaded : {&loaded_a, &loaded_b}) {
    equal = ReportCorruption(*loaded) == kSuccess && equal;
  }
  if (a.options != b.options) {
    for (const LayerSet* map : {&a, &b}) {
      Say(stdout, "{}: knot_interval_m {}, control points {} .. {} log-odds",
          map == &a ? path_a : path_b, map->options.knot_interval_m,
          map->options.limits.min / double{kUnitsPerLogOdds},
          map->options.limits.max / double{kUnitsPerLogOdds});
    }
    return kFailed;
  }
  std::set<const LayerSnapshot*> taken;
  for (const LayerSnapshot& layer : a.layers) {
    const LayerSnapshot* other = Counterpart(layer.id, a.layers, b.layers, taken);
    if (other == nullptr) {
      if (layer.tiles.size() == 0) continue;
      Say(stdout, "layer {}: only in {}", layer.id.name, path_a);
      equal = false;
      continue;
    }
    taken.insert(other);
    const std::string settings_a = SettingsText(a.settings.Of(layer.id));
    const std::string settings_b = SettingsText(b.settings.Of(other->id));
    if (settings_a != settings_b) {
      Say(stdout, "layer {}: {} in {}, {} in {}", layer.id.name, settings_a, path_a, settings_b,
          path_b);
      equal = false;
    }
    const Difference difference = Compare(layer.tiles, other->tiles);
    if (difference.tiles == 0) continue;
    Say(stdout, "layer {}: {} tiles differ, in {} control points", layer.id.name, difference.tiles,
        difference.control_points);
    equal = false;
  }
  for (const LayerSnapshot& layer : b.layers) {
    if (taken.contains(&layer) || layer.tiles.size() == 0) continue;
    Say(stdout, "layer {}: only in {}", layer.id.name, path_b);
    equal = false;
  }
  const auto sum_a = ViewOf(a);
  if (const Difference difference = Compare(sum_a->tiles, ViewOf(b)->tiles); difference.tiles > 0) {
    Say(stdout, "the sum of all layers: {} tiles differ, in {} control points", difference.tiles,
        difference.control_points);
    equal = false;
  }
  if (equal) {
    Say(stdout, "equal (layers: {}, tiles: {})", a.layers.size(), sum_a->tiles.size());
  }
  ReportRemovals(a, b, path_a);
  ReportRemovals(b, a, path_b);
  return equal ? kSuccess : kFailed;
}

constexpr const char* kDiffExamples = R"(
Example:
  splinemap diff live.splinemap offline.splinemap && echo the same map

Compares content: layers by name, control points, and which layers are muted or shifted. Ignores
session_numbers, nonces, times and layers without tiles; says which layers only one of the maps knows to
be removed.
Exit status: 0 equal, 1 different or failed, 2 usage.)";

}  // namespace

void AddDiff(CLI::App& app, Command& chosen) {
  auto paths = std::make_shared<std::pair<std::string, std::string>>();
  CLI::App* command = app.add_subcommand("diff", "Compare two maps");
  command->footer(kDiffExamples);
  command->add_option("A", paths->first, "Map file")->required();
  command->add_option("B", paths->second, "Map file")->required();
  command->callback(
      [paths, &chosen] { chosen = [paths] { return Diff(paths->first, paths->second); }; });
}

}  // namespace splinemap
