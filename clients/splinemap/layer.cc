#include <CLI/App.hpp>
#include <array>
#include <cstdio>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/types/span.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_edit.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "lib/fleet/nats_fleet_store.h"
#include "lib/map/summed_layers.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct LayerFlags {
  LayerCommand command = LayerCommand::kMute;
  MapSourceFlags source;
  Output output;
  bool accepts_corrupt = false;
};

// What the positionals after the map are.
struct LayerArguments {
  std::vector<std::string> layers;
  Pose2 placement;  // of kPlace
};

constexpr const char* kPlacementArguments =
    "give the layer, then where its frame lies in the map's: X_M Y_M YAW_DEG";

absl::StatusOr<Pose2> ParsePlacement(absl::Span<const std::string> words) {
  std::array<double, 3> numbers;
  for (size_t k = 0; k < numbers.size(); ++k) {
    if (!absl::SimpleAtod(words[k], &numbers[k])) {
      return InvalidArgument("{} is no number; {}", words[k], kPlacementArguments);
    }
  }
  const Pose2 placement{{numbers[0], numbers[1]}, numbers[2] * std::numbers::pi / 180};
  if (!FixedPose2::IsInRange(placement)) {
    return InvalidArgument("a layer can be placed within {:.0f} km at most",
                           1e-3 * FixedPose2::kMaxUnits / FixedPose2::kUnitsPerMetre);
  }
  return placement;
}

absl::StatusOr<LayerArguments> ParseArguments(const LayerFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto words, ArgumentsAfterMap(flags.source));
  LayerArguments arguments{{words.begin(), words.end()}, {}};
  std::vector<std::string>& layers = arguments.layers;
  if (flags.command == LayerCommand::kPlace) {
    constexpr size_t kNumbers = 3;
    if (layers.size() <= kNumbers) return InvalidArgument("{}", kPlacementArguments);
    SPLINEMAP_ASSIGN_OR_RETURN(arguments.placement,
                               ParsePlacement(absl::MakeSpan(layers).last(kNumbers)));
    layers.resize(layers.size() - kNumbers);
  }
  if (layers.empty()) return InvalidArgument("give the layer to change");
  return arguments;
}

absl::StatusOr<int> ChangeFile(const LayerFlags& flags, const LayerArguments& arguments) {
  const std::string& map = flags.source.arguments.front();
  if (flags.output.path.empty()) return InvalidArgument("give the map file to write with --out");
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {map}));
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadInput(map, flags.accepts_corrupt));
  std::vector<LayerId> candidates;
  for (const LayerSnapshot& layer : loaded.set.layers) candidates.push_back(layer.id);
  std::vector<LayerId> found;
  for (const std::string& text : arguments.layers) {
    SPLINEMAP_ASSIGN_OR_RETURN(found.emplace_back(), FindLayer(candidates, text, map));
  }
  for (const LayerId& id : found) {
    SPLINEMAP_RETURN_IF_ERROR(EditLayer(flags.command, arguments.placement, id, loaded.set));
    PrintLine(stderr, "{} {}", NameOf(flags.command), NameOf(id));
  }
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.path));
  PrintLine(stderr, "{} layers, {} tiles in {}", loaded.set.layers.size(),
            ViewOf(loaded.set)->tiles.size(), flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

absl::StatusOr<int> ChangeLive(const LayerFlags& flags, const LayerArguments& arguments) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<LiveLayer> layers,
                             FindLiveLayers(flags.source, arguments.layers));
  for (const LiveLayer& layer : layers) {
    SPLINEMAP_RETURN_IF_ERROR(
        EditLiveLayer(flags.source.bus, layer, flags.command, arguments.placement));
  }
  return kSuccess;
}

absl::StatusOr<int> ChangeFleet(const LayerFlags& flags, const LayerArguments& arguments) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto store, NatsFleetStore::Connect(flags.source.fleet));
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<FleetLayer> layers,
                             FindFleetLayers(*store, arguments.layers));
  for (const FleetLayer& layer : layers) {
    SPLINEMAP_RETURN_IF_ERROR(EditFleetLayer(*store, layer, flags.command, arguments.placement));
  }
  return kSuccess;
}

absl::StatusOr<int> ChangeLayer(const LayerFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerArguments arguments, ParseArguments(flags));
  if (flags.source.IsFleet()) return ChangeFleet(flags, arguments);
  return flags.source.live ? ChangeLive(flags, arguments) : ChangeFile(flags, arguments);
}

constexpr const char* kLayerExamples = R"(
Examples:
  splinemap layer mute --live robot-3
  splinemap layer place --live robot-3 2 -0.1 30   its origin lies at (2, -0.1) m, its axes are
                                                   turned by 30 degrees, counter-clockwise
  splinemap layer low-weight --live robot-3@5f20   counts less than the others
  splinemap layer remove fleet.splinemap robot-3 robot-4 --out without.splinemap
  splinemap layer remove --fleet nats://hub --credentials operator robot-3

With --live every daemon and client on the bus applies the settings, and those that are offline do
so when they return. With --fleet so do all of the fleet, which takes the credentials of an
operator. With MAP the command writes a changed copy. A removed layer is deleted for
good, from the disk of its robot too, and merging with an older file does not restore it. A layer is
given as NAME, or as NAME@ORIGIN, of which the first digits suffice; splinemap layers lists them.

A placement is that of the frame of the robot's poses, not from where it was placed before; 0 0 0
takes it back. A daemon without scans of the layer, as a base station, takes the frame in which its
owner mapped it for that.
A layer whose scans are all there, in the file or at its owner's daemon, is made anew and is exact.
Of others whole knot intervals and quarters of a turn are exact, and else they are interpolated
whenever the map is read, and called approximate.)";

constexpr const char* kLayerCommandExamples = R"(
Examples:
  splinemap layer {0} --live robot-3{1}
  splinemap layer {0} fleet.splinemap robot-3@5f20{1} --out changed.splinemap
  splinemap layer {0} --fleet nats://hub robot-3{1}

splinemap layer --help explains the settings.)";

void AddLayerCommand(CLI::App& parent, const LayerCommandText& text, Command& chosen) {
  auto flags = std::make_shared<LayerFlags>();
  flags->command = text.command;
  const bool is_place = text.command == LayerCommand::kPlace;
  CLI::App* command = parent.add_subcommand(text.name, text.what);
  command->footer(fmt::format(kLayerCommandExamples, text.name, is_place ? " 2 -0.1 30" : ""));
  AddMapSource(
      *command, is_place ? "MAP LAYER X_M Y_M YAW_DEG" : "MAP LAYER",
      is_place ? "the layer, and where its frame lies in the map's" : "the layer, or several",
      flags->source);
  AddOutOption(*command, "Map file to write; required with MAP", flags->output)
      ->excludes("--live", "--fleet");
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return ChangeLayer(*flags); }; });
}

}  // namespace

void AddLayer(CLI::App& app, Command& chosen) {
  CLI::App* layer = app.add_subcommand("layer", "Change the settings of a layer, or remove it");
  layer->footer(kLayerExamples);
  layer->require_subcommand(1);
  for (const LayerCommandText& text : kLayerCommands) AddLayerCommand(*layer, text, chosen);
}

}  // namespace splinemap
