#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/say.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/map/flattened.h"

namespace splinemap {
namespace {

struct FlattenFlags {
  std::string map;
  std::string name = "flat";
  MapOutput output;
};

absl::StatusOr<int> Flatten(const FlattenFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckRobotName(flags.name));
  SPLINEMAP_RETURN_IF_ERROR(CheckOutputOf({flags.map}, flags.output));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadInput(flags.map, flags.output));
  const LayerSet& map = loaded.set;
  const LayerSet flat = Flattened(map, {flags.name, RandomId()}, {1, RandomId()});
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(flat, flags.output.out));
  size_t summed = 0;
  for (const LayerSnapshot& layer : map.layers) {
    const LayerSettings& setting = map.settings.Of(layer.id);
    summed += setting.IsSummed() ? 1 : 0;
    if (setting.IsSummed()) continue;
    Say(stderr, "{} is left out: {}", NameOf(layer.id), TextOf(setting, layer.session));
  }
  Say(stderr, "{} layers are one, {}; {} tiles in {}", summed, NameOf(flat.layers.front().id),
      flat.layers.front().tiles.size(), flags.output.out);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

constexpr const char* kFlattenExamples = R"(
Example:
  splinemap flatten fleet.splinemap -o flat.splinemap --name lab

One layer that is the sum of all, without those that are muted, shifted as was set. Its parts
cannot be told apart any more: merged with a map of one of its robots, what that saw counts twice.)";

}  // namespace

void AddFlatten(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<FlattenFlags>();
  CLI::App* command = app.add_subcommand("flatten", "Make one layer of all");
  command->footer(kFlattenExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("--name", flags->name, "Of the layer (default flat)");
  AddMapOutputFlags(*command, flags->output);
  command->callback([flags, &chosen] { chosen = [flags] { return Flatten(*flags); }; });
}

}  // namespace splinemap
