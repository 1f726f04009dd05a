#include <CLI/App.hpp>
#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/types/span.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "lcmtypes/splinemap/layer_status_t.hpp"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/layers/layer_edits.h"
#include "lib/map/summed_layers.h"
#include "splinemap/client.h"
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

// Makes the layer anew from its scans, where all of them are there. The placement that is left to
// those who read it.
absl::StatusOr<FixedPose2> PlaceExactly(const FixedPose2& placement, const LayerId& id,
                                        LayerSet& set) {
  const std::shared_ptr<const ScanArchive> archive = set.Find(id)->archive;
  if (archive == nullptr) return placement;
  if (archive->num_scans() == 0 || !archive->base.IsEmpty()) {
    return FixedPose2::Nearest(placement.ToPose() * Inverse(archive->map_T_world.ToPose()));
  }
  SPLINEMAP_RETURN_IF_ERROR(
      Refold(set, {NameOf(id)}, [&](const ScanArchive&) -> absl::StatusOr<ArchiveEdit> {
        ArchiveEdit edit;
        edit.map_T_world = placement;
        return edit;
      }));
  return FixedPose2();
}

absl::Status Change(LayerCommand command, const Pose2& placement, const LayerId& id,
                    LayerSet& set) {
  LayerSettings settings = set.settings.Next(id, RandomId());
  if (command == LayerCommand::kRemove) {
    SPLINEMAP_ASSIGN_OR_RETURN(set, WithoutLayers(set, {id}, RandomId()));
    return absl::OkStatus();
  }
  FixedPose2 on_read = FixedPose2::Nearest(placement);
  if (command == LayerCommand::kPlace) {
    SPLINEMAP_ASSIGN_OR_RETURN(on_read, PlaceExactly(on_read, id, set));
  }
  Apply(command, on_read, set.Find(id)->session, settings);
  if (!set.settings.Merge(id, settings)) {
    return FailedPrecondition("the map has no room for settings of another layer");
  }
  return absl::OkStatus();
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
    SPLINEMAP_RETURN_IF_ERROR(Change(flags.command, arguments.placement, id, loaded.set));
    PrintLine(stderr, "{} {}", NameOf(flags.command), NameOf(id));
  }
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.path));
  PrintLine(stderr, "{} layers, {} tiles in {}", loaded.set.layers.size(),
            ViewOf(loaded.set)->tiles.size(), flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

struct LiveLayer {
  std::string daemon;  // one that has the layer
  LayerId id;
  uint64_t session_number = 0;
};

absl::StatusOr<std::vector<LiveLayer>> ReceiveNamedLayers(const LayerFlags& flags,
                                                          const LayerArguments& arguments) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<layers_t> daemons,
                             ReceiveLayers(flags.source.bus, flags.source.robot));
  std::map<LayerId, LiveLayer> received;
  for (const layers_t& daemon : daemons) {
    for (const layer_status_t& layer : daemon.layers) {
      const LayerId id{layer.settings.name, static_cast<uint64_t>(layer.settings.origin)};
      if (layer.state == "removed") continue;
      const LiveLayer here{daemon.name, id, static_cast<uint64_t>(layer.session_number)};
      // Its owner places it exactly.
      const bool is_owner = &layer == &daemon.layers.front() && layer.state == "own";
      if (is_owner) received.insert_or_assign(id, here);
      received.try_emplace(id, here);
    }
  }
  std::vector<LayerId> candidates;
  for (const auto& [id, layer] : received) candidates.push_back(id);
  const std::string where =
      flags.source.robot.empty() ? "the bus" : "the daemon of " + flags.source.robot;
  std::vector<LiveLayer> found;
  for (const std::string& text : arguments.layers) {
    SPLINEMAP_ASSIGN_OR_RETURN(const LayerId id, FindLayer(candidates, text, where));
    found.push_back(received.at(id));
  }
  return found;
}

absl::StatusOr<int> ChangeLive(const LayerFlags& flags, const LayerArguments& arguments) {
  absl::StatusOr<std::vector<LiveLayer>> layers = ReceiveNamedLayers(flags, arguments);
  // Messages may be lost.
  for (int n = 0; n < 3 && !layers.ok(); ++n) layers = ReceiveNamedLayers(flags, arguments);
  SPLINEMAP_RETURN_IF_ERROR(layers.status());
  for (const LiveLayer& layer : *layers) {
    ClientOptions options;
    options.channel_prefix = flags.source.bus.channel_prefix;
    options.robot = layer.daemon;
    SPLINEMAP_ASSIGN_OR_RETURN(const auto client,
                               MapClient::Connect(flags.source.bus.lcm_url, options));
    SPLINEMAP_RETURN_IF_ERROR(
        client->Set({flags.command, layer.id, layer.session_number, arguments.placement}));
    PrintLine(stderr, "{} {}: saved by the daemon of {}; the others follow within 2 s",
              NameOf(flags.command), NameOf(layer.id), layer.daemon);
  }
  return kSuccess;
}

absl::StatusOr<int> ChangeLayer(const LayerFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerArguments arguments, ParseArguments(flags));
  return flags.source.live ? ChangeLive(flags, arguments) : ChangeFile(flags, arguments);
}

constexpr const char* kLayerExamples = R"(
Examples:
  splinemap layer mute --live robot-3
  splinemap layer place --live robot-3 2 -0.1 30   its origin lies at (2, -0.1) m, its axes are
                                                   turned by 30 degrees, counter-clockwise
  splinemap layer low-weight --live robot-3@5f20   counts less than the others
  splinemap layer remove fleet.splinemap robot-3 robot-4 --out without.splinemap

With --live every daemon and client on the bus applies the settings, and those that are offline do
so when they return. With MAP the command writes a changed copy. A removed layer is deleted for
good, from the disk of its robot too, and merging with an older file does not restore it. A layer is
given as NAME, or as NAME@ORIGIN, of which the first digits suffice; splinemap layers lists them.

A placement is that of the layer's frame, not from where it was placed before; 0 0 0 takes it back.
A layer whose scans are all there, in the file or at its owner's daemon, is made anew and is exact.
Of others whole knot intervals and quarters of a turn are exact, and else they are interpolated
whenever the map is read, and called approximate.)";

constexpr const char* kLayerCommandExamples = R"(
Examples:
  splinemap layer {0} --live robot-3{1}
  splinemap layer {0} fleet.splinemap robot-3@5f20{1} --out changed.splinemap

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
      ->excludes(command->get_option("--live"));
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
