#include <algorithm>
#include <cstdio>
#include <memory>
#include <set>

#include "clients/splinemap/commands.h"
#include "lib/base/status.h"
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

absl::StatusOr<int> Diff(const std::string& path_a, const std::string& path_b) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded_a, ReadMapFile(path_a));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded_b, ReadMapFile(path_b));
  const MapSnapshot& a = *loaded_a.map;
  const MapSnapshot& b = *loaded_b.map;
  bool equal = true;
  for (const LoadedMap* loaded : {&loaded_a, &loaded_b}) {
    equal = ReportDamages(*loaded) == kSuccess && equal;
  }
  if (a.options != b.options) {
    for (const MapSnapshot* map : {&a, &b}) {
      fmt::print("{}: knot_interval_m {}, control points {} .. {} log-odds\n",
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
      std::printf("layer %s: only in %s\n", layer.id.name.c_str(), path_a.c_str());
      equal = false;
      continue;
    }
    taken.insert(other);
    const Difference difference = Compare(layer.tiles, other->tiles);
    if (difference.tiles == 0) continue;
    std::printf("layer %s: %ld tiles differ, in %ld control points\n", layer.id.name.c_str(),
                static_cast<long>(difference.tiles), static_cast<long>(difference.control_points));
    equal = false;
  }
  for (const LayerSnapshot& layer : b.layers) {
    if (taken.contains(&layer)) continue;
    std::printf("layer %s: only in %s\n", layer.id.name.c_str(), path_b.c_str());
    equal = false;
  }
  if (equal) {
    std::printf("equal (layers: %zu, tiles: %zu)\n", a.layers.size(), a.merged.size());
  }
  return equal ? kSuccess : kFailed;
}

constexpr const char* kExamples = R"(
Example:
  splinemap diff live.splinemap offline.splinemap && echo the same map

Compares content: layers by name, then control points. Ignores incarnations, nonces and times.
Exit status: 0 equal, 1 different or failed, 2 usage.)";

}  // namespace

void AddDiff(CLI::App& app, Command& chosen) {
  auto paths = std::make_shared<std::pair<std::string, std::string>>();
  CLI::App* command = app.add_subcommand("diff", "Compare two maps");
  command->footer(kExamples);
  command->add_option("A", paths->first, "Map file")->required();
  command->add_option("B", paths->second, "Map file")->required();
  command->callback(
      [paths, &chosen] { chosen = [paths] { return Diff(paths->first, paths->second); }; });
}

}  // namespace splinemap
