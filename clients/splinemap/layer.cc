#include <CLI/App.hpp>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/live_layers.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
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

// A shift along one axis as it is typed: knot intervals, or metres.
struct TypedShift {
  std::string text;
  double number = 0;
  bool is_in_metres = false;
};

// What the positionals after the map are.
struct LayerArguments {
  std::vector<std::string> layers;
  TypedShift x, y;  // of kShift
};

absl::StatusOr<TypedShift> ParseShift(const std::string& text) {
  TypedShift shift{text, 0, text.ends_with('m')};
  const std::string number = text.substr(0, text.size() - (shift.is_in_metres ? 1 : 0));
  if (!absl::SimpleAtod(number, &shift.number) || !std::isfinite(shift.number)) {
    return InvalidArgument(
        "{} is no shift; give X and Y in knot intervals, 40 -2, or in metres, 2m -0.1m", text);
  }
  return shift;
}

absl::StatusOr<LayerArguments> ParseArguments(const LayerFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto words, ArgumentsAfterMap(flags.source));
  LayerArguments arguments{{words.begin(), words.end()}, {}, {}};
  if (flags.command == LayerCommand::kShift) {
    std::vector<std::string>& layers = arguments.layers;
    if (layers.size() < 3) {
      return InvalidArgument(
          "give the layer, then X and Y in knot intervals, 40 -2, or in metres, 2m -0.1m");
    }
    SPLINEMAP_ASSIGN_OR_RETURN(arguments.y, ParseShift(layers.back()));
    layers.pop_back();
    SPLINEMAP_ASSIGN_OR_RETURN(arguments.x, ParseShift(layers.back()));
    layers.pop_back();
  }
  if (arguments.layers.empty()) return InvalidArgument("give the layer to change");
  return arguments;
}

// In whole knot intervals.
absl::StatusOr<int32_t> KnotsOf(const TypedShift& shift, double knot_m) {
  constexpr double kRounding = 1e-3;  // of a knot interval
  const double knots = shift.is_in_metres ? shift.number / knot_m : shift.number;
  if (!(std::abs(knots) <= KnotShift::kMax)) {
    return InvalidArgument("a layer can be shifted by {} knots at most", KnotShift::kMax);
  }
  if (std::abs(knots - std::round(knots)) > kRounding) {
    const std::string of = shift.is_in_metres ? fmt::format(" of {} m", knot_m) : "";
    const auto typed = [&](double whole) {
      return shift.is_in_metres ? fmt::format("{:.12g}m", whole * knot_m)
                                : fmt::format("{}", whole);
    };
    return InvalidArgument("{} is no whole number of knot intervals{}; {} and {} are", shift.text,
                           of, typed(std::floor(knots)), typed(std::ceil(knots)));
  }
  return static_cast<int32_t>(std::lround(knots));
}

absl::StatusOr<KnotShift> ShiftOf(const LayerArguments& arguments, double knot_m) {
  KnotShift shift;
  SPLINEMAP_ASSIGN_OR_RETURN(shift.i, KnotsOf(arguments.x, knot_m));
  SPLINEMAP_ASSIGN_OR_RETURN(shift.j, KnotsOf(arguments.y, knot_m));
  return shift;
}

absl::Status Change(LayerCommand command, KnotShift shift, const LayerId& id, LayerSet& set) {
  LayerSettings settings = set.settings.Next(id, RandomId());
  if (command == LayerCommand::kRemove) {
    SPLINEMAP_ASSIGN_OR_RETURN(set, WithoutLayers(set, {id}, RandomId()));
    return absl::OkStatus();
  }
  Apply(command, shift, set.Find(id)->session, settings);
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
  SPLINEMAP_ASSIGN_OR_RETURN(const KnotShift shift,
                             ShiftOf(arguments, loaded.set.options.knot_interval_m));
  std::vector<LayerId> candidates;
  for (const LayerSnapshot& layer : loaded.set.layers) candidates.push_back(layer.id);
  std::vector<LayerId> found;
  for (const std::string& text : arguments.layers) {
    SPLINEMAP_ASSIGN_OR_RETURN(found.emplace_back(), FindLayer(candidates, text, map));
  }
  for (const LayerId& id : found) {
    SPLINEMAP_RETURN_IF_ERROR(Change(flags.command, shift, id, loaded.set));
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
      received.try_emplace(id, daemon.name, id, static_cast<uint64_t>(layer.session_number));
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
    double knot_m = 1;
    if (arguments.x.is_in_metres || arguments.y.is_in_metres) {
      SPLINEMAP_ASSIGN_OR_RETURN(knot_m, ReceiveKnotInterval(flags.source.bus, layer.id));
    }
    SPLINEMAP_ASSIGN_OR_RETURN(const KnotShift shift, ShiftOf(arguments, knot_m));
    ClientOptions options;
    options.channel_prefix = flags.source.bus.channel_prefix;
    options.robot = layer.daemon;
    SPLINEMAP_ASSIGN_OR_RETURN(const auto client,
                               MapClient::Connect(flags.source.bus.lcm_url, options));
    SPLINEMAP_RETURN_IF_ERROR(client->Set({flags.command, layer.id, layer.session_number, shift}));
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
  splinemap layer shift --live robot-3 40 -2       40 knots along x, -2 along y, from its frame
  splinemap layer shift --live robot-3 2m -0.1m    the same in metres, at a knot interval of 0.05 m
  splinemap layer low-weight --live robot-3@5f20   counts less than the others
  splinemap layer remove fleet.splinemap robot-3 robot-4 --out without.splinemap

With --live every daemon and client on the bus applies the settings, and those that are offline do
so when they return. With MAP the command writes a changed copy. A removed layer is deleted for
good, from the disk of its robot too, and merging with an older file does not restore it. A layer is
given as NAME, or as NAME@ORIGIN, of which the first digits suffice; splinemap layers lists them.)";

constexpr const char* kLayerCommandExamples = R"(
Examples:
  splinemap layer {0} --live robot-3{1}
  splinemap layer {0} fleet.splinemap robot-3@5f20{1} --out changed.splinemap

splinemap layer --help explains the settings.)";

void AddLayerCommand(CLI::App& parent, const LayerCommandText& text, Command& chosen) {
  auto flags = std::make_shared<LayerFlags>();
  flags->command = text.command;
  const bool is_shift = text.command == LayerCommand::kShift;
  CLI::App* command = parent.add_subcommand(text.name, text.what);
  command->footer(fmt::format(kLayerCommandExamples, text.name, is_shift ? " 40 -2" : ""));
  AddMapSource(*command, is_shift ? "MAP LAYER X Y" : "MAP LAYER",
               is_shift ? "the layer, and knot intervals, or metres (2m), along x and y"
                        : "the layer, or several",
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
