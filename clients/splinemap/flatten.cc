#include <CLI/App.hpp>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/print.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/map/flattened.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct FlattenFlags {
  std::string map;
  std::string name = "flat";
  Output output;
  bool accepts_corrupt = false;
};

absl::StatusOr<int> Flatten(const FlattenFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckRobotName(flags.name));
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadInput(flags.map, flags.accepts_corrupt));
  const LayerSet& map = loaded.set;
  const LayerSet flat = Flattened(map, {flags.name, RandomId()}, {1, RandomId()});
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(flat, flags.output.path));
  size_t summed = 0;
  for (const LayerSnapshot& layer : map.layers) {
    const LayerSettings& settings = map.settings.Of(layer.id);
    summed += settings.IsSummed() ? 1 : 0;
    if (settings.IsSummed()) continue;
    PrintLine(stderr, "{} is left out: {}", NameOf(layer.id),
              TextOf(settings, settings.placement, /*is_there=*/true));
  }
  PrintLine(stderr, "summed {} layers into {}; {} tiles in {}", summed,
            NameOf(flat.layers.front().id), flat.layers.front().tiles.size(), flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

constexpr const char* kFlattenExamples = R"(
Example:
  splinemap flatten fleet.splinemap flat.splinemap --name lab

Writes one layer that is the sum of all, without muted layers and with all in their places. The parts
cannot be separated again: merged with the map of one of its robots, the flat layer counts that
robot's measurements twice.)";

}  // namespace

void AddFlatten(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<FlattenFlags>();
  CLI::App* command = app.add_subcommand("flatten", "Sum the layers of a map file into one layer");
  command->footer(kFlattenExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  command->add_option("--name", flags->name, "Name of the layer (default flat)");
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return Flatten(*flags); }; });
}

}  // namespace splinemap
