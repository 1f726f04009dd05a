#include <CLI/App.hpp>
#include <algorithm>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <tuple>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "clients/splinemap/time_flag.h"
#include "lib/base/status.h"
#include "lib/map/summed_layers.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct DiffFlags {
  std::string a;
  std::string b;
  std::string at;
  bool json = false;
};

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
    const std::shared_ptr<const Tile> other = FindTile(b, key);
    compare(*entry.tile->Get(), other == nullptr ? kZeros : *other);
  });
  b.ForEach([&](TileKey key, const TileTree::Entry& entry) {
    if (a.Find(key) == nullptr) compare(*entry.tile->Get(), kZeros);
  });
  return difference;
}

bool Has(const std::vector<LayerSnapshot>& layers, const LayerId& id) {
  return std::any_of(layers.begin(), layers.end(),
                     [&](const LayerSnapshot& layer) { return layer.id == id; });
}

// The layer of `layers` to compare with `id` of `others`: the same one, or else one of its name
// that is not taken and has no counterpart of its own id, since two builds of one robot differ in
// origin.
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

// The settings of a layer, as far as they matter for the sum.
auto SettingsOfSum(const LayerSettings& settings) {
  return std::tie(settings.muted, settings.low_weight, settings.placement);
}
std::string SumSettingsText(const LayerSettings& settings) {
  const std::string text = TextOf(settings, settings.placement, /*is_there=*/true);
  return text.empty() ? "no settings" : text;
}

// What differs, as text for people and as JSON.
class Differences {
 public:
  Differences(const LoadedMap& a, const LoadedMap& b) {
    for (const LoadedMap* loaded : {&a, &b}) {
      is_equal_ = ReportCorruption(*loaded) == kSuccess && is_equal_;
    }
  }

  // Notes that the maps are not equal.
  void Add(std::string text, nlohmann::json json) {
    is_equal_ = false;
    Note(std::move(text), std::move(json));
  }
  // Notes what does not make the maps differ.
  void Note(std::string text, nlohmann::json json) {
    lines_.push_back(std::move(text));
    json_.push_back(std::move(json));
  }
  void AddTiles(const std::string& what, const Difference& difference, nlohmann::json json) {
    if (difference.tiles == 0) return;
    json["tiles"] = difference.tiles;
    json["control_points"] = difference.control_points;
    Add(fmt::format("{}: {} tiles differ, in {} control points", what, difference.tiles,
                    difference.control_points),
        std::move(json));
  }
  bool is_equal() const { return is_equal_; }

  int Report(const std::string& equal_text, bool as_json) const {
    if (as_json) {
      PrintJson({{"equal", is_equal_}, {"differences", json_}});
    } else {
      if (is_equal_) PrintLine(stdout, "{}", equal_text);
      for (const std::string& line : lines_) PrintLine(stdout, "{}", line);
    }
    return is_equal_ ? kSuccess : kFailed;
  }

 private:
  bool is_equal_ = true;
  std::vector<std::string> lines_;
  nlohmann::json json_ = nlohmann::json::array();
};

// Layers that only one of the maps has a removal of. The maps are equal, but what is merged with
// them need not be.
void NoteRemovals(const LayerSet& map, const LayerSet& other, const std::string& path,
                  Differences& differences) {
  for (const auto& [id, settings] : map.settings.records()) {
    if (settings.removed_up_to <= other.settings.Of(id).removed_up_to) continue;
    differences.Note(
        fmt::format("layer {}: removed, only in {}", NameOf(id), path),
        {{"layer", id.name}, {"removed_up_to", settings.removed_up_to}, {"only_in", path}});
  }
}

void AddMissing(const LayerSnapshot& layer, const std::string& path, Differences& differences) {
  if (layer.tiles.size() == 0) return;
  differences.Add(fmt::format("layer {}: only in {}", layer.id.name, path),
                  {{"layer", layer.id.name}, {"only_in", path}});
}

std::string OptionsText(const MapOptions& options) {
  return fmt::format("knot_interval_m {}, control points {} .. {} log-odds",
                     options.knot_interval_m, options.limits.min / double{kUnitsPerLogOdds},
                     options.limits.max / double{kUnitsPerLogOdds});
}

void CompareLayers(const LayerSet& a, const LayerSet& b, const DiffFlags& flags,
                   Differences& differences) {
  std::set<const LayerSnapshot*> taken;
  for (const LayerSnapshot& layer : a.layers) {
    const LayerSnapshot* other = Counterpart(layer.id, a.layers, b.layers, taken);
    if (other == nullptr) {
      AddMissing(layer, flags.a, differences);
      continue;
    }
    taken.insert(other);
    const std::string settings_a = SumSettingsText(a.settings.Of(layer.id));
    const std::string settings_b = SumSettingsText(b.settings.Of(other->id));
    if (SettingsOfSum(a.settings.Of(layer.id)) != SettingsOfSum(b.settings.Of(other->id))) {
      differences.Add(fmt::format("layer {}: {} in {}, {} in {}", layer.id.name, settings_a,
                                  flags.a, settings_b, flags.b),
                      {{"layer", layer.id.name}, {"settings", {settings_a, settings_b}}});
    }
    differences.AddTiles("layer " + layer.id.name, Compare(layer.tiles, other->tiles),
                         {{"layer", layer.id.name}});
  }
  for (const LayerSnapshot& layer : b.layers) {
    if (!taken.contains(&layer)) AddMissing(layer, flags.b, differences);
  }
}

absl::StatusOr<int> Diff(const DiffFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded_a, ReadMapFile(flags.a));
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded_b, ReadMapFile(flags.b));
  if (!flags.at.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(WindBack(loaded_a.set, flags.at));
    SPLINEMAP_RETURN_IF_ERROR(WindBack(loaded_b.set, flags.at));
  }
  const LayerSet& a = loaded_a.set;
  const LayerSet& b = loaded_b.set;
  Differences differences(loaded_a, loaded_b);
  if (a.options != b.options) {
    const std::string options_a = OptionsText(a.options);
    const std::string options_b = OptionsText(b.options);
    differences.Add(fmt::format("{} in {}, {} in {}", options_a, flags.a, options_b, flags.b),
                    {{"options", {options_a, options_b}}});
    return differences.Report("", flags.json);
  }
  CompareLayers(a, b, flags, differences);
  const auto sum_a = ViewOf(a);
  differences.AddTiles("the sum of all layers", Compare(sum_a->tiles, ViewOf(b)->tiles),
                       {{"sum", true}});
  NoteRemovals(a, b, flags.a, differences);
  NoteRemovals(b, a, flags.b, differences);
  return differences.Report(
      fmt::format("equal (layers: {}, tiles: {})", a.layers.size(), sum_a->tiles.size()),
      flags.json);
}

constexpr const char* kDiffExamples = R"(
Examples:
  splinemap diff live.splinemap offline.splinemap && echo equal
  splinemap diff live.splinemap offline.splinemap --json

Compares layers by name, their control points, and their settings: muted, weight, placement. Ignores
session numbers, nonces, times and layers without tiles. Lists removals that only one map records.
Exit status: 0 equal, 1 different or failed, 2 usage.)";

}  // namespace

void AddDiff(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<DiffFlags>();
  CLI::App* command = app.add_subcommand("diff", "Compare two map files");
  command->footer(kDiffExamples);
  command->add_option("MAP", flags->a, "Map file")->required();
  command->add_option("OTHER", flags->b, "Map file to compare with")->required();
  command->add_option("--at", flags->at, std::string("The maps as they were then; ") + kTimeHelp)
      ->type_name("TIME");
  AddJsonFlag(*command, flags->json);
  command->callback([flags, &chosen] { chosen = [flags] { return Diff(*flags); }; });
}

}  // namespace splinemap
