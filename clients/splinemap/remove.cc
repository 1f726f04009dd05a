#include <algorithm>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/say.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/layers/layer_edits.h"
#include "lib/map/summed_layers.h"

namespace splinemap {
namespace {

struct RemoveFlags {
  std::string map;
  std::vector<std::string> layers;
  MapOutput output;
};

absl::StatusOr<int> Remove(const RemoveFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutputOf({flags.map}, flags.output));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadInput(flags.map, flags.output));
  std::vector<LayerId> layers;
  for (const LayerSnapshot& layer : loaded.set.layers) layers.push_back(layer.id);
  std::vector<LayerId> removed;
  for (const std::string& text : flags.layers) {
    SPLINEMAP_ASSIGN_OR_RETURN(removed.emplace_back(), FindLayer(layers, text, flags.map));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerSet rest, WithoutLayers(loaded.set, removed, RandomId()));
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(rest, flags.output.out));
  for (const LayerId& id : removed) Say(stderr, "{} is removed", NameOf(id));
  Say(stderr, "{} layers, {} tiles in {}", rest.layers.size(), ViewOf(rest)->tiles.size(),
      flags.output.out);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

constexpr const char* kRemoveExamples = R"(
Examples:
  splinemap remove fleet.splinemap robot-3 -o without.splinemap
  splinemap remove fleet.splinemap robot-3@5f20 robot-4 -o without.splinemap

The map as if these layers had never been, and a record of that: merged with older files, they stay
away. splinemap layers shows the names and origins.)";

}  // namespace

void AddRemove(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RemoveFlags>();
  CLI::App* command = app.add_subcommand("remove", "Take layers out of a map");
  command->footer(kRemoveExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command
      ->add_option(
          "LAYER", flags->layers,
          "NAME, or NAME@ORIGIN where there are several; the origin's first digits will do")
      ->required();
  AddMapOutputFlags(*command, flags->output);
  command->callback([flags, &chosen] { chosen = [flags] { return Remove(*flags); }; });
}

}  // namespace splinemap
