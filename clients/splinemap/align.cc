#include "lib/matching/align.h"

#include <CLI/App.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_edit.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "clients/splinemap/typed_placement.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/fleet/nats_fleet_store.h"
#include "lib/map/summed_layers.h"
#include "lib/render/overlay.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

constexpr double kDegree_rad = std::numbers::pi / 180;

struct AlignFlags {
  MapSourceFlags source;  // and another map, or two layers
  AlignOptions options;
  std::string picture;
  bool apply = false;
  Output output;  // of `apply`, unless live
  bool json = false;
};

// A map, or one layer of a map, and what people call it.
struct AlignedMap {
  std::string name;
  LayerId layer;  // of a layer
  std::shared_ptr<const MapView> view;
};

struct AlignedMaps {
  AlignedMap a;
  AlignedMap b;
  LayerSet layers;  // among which are those of b
  std::vector<LayerId> layers_of_b;
  int exit_status = kSuccess;  // of a command that else succeeded
};

// One layer by itself, where it is placed in the map, also if it is muted.
absl::StatusOr<AlignedMap> LayerOf(const LayerSet& set, const std::string& text,
                                   const std::string& where) {
  std::vector<LayerId> ids;
  for (const LayerSnapshot& layer : set.layers) ids.push_back(layer.id);
  SPLINEMAP_ASSIGN_OR_RETURN(const LayerId id, FindLayer(ids, text, where));
  LayerSet alone{.options = set.options, .layers = {*set.Find(id)}};
  LayerSettings settings = set.settings.Of(id);
  settings.muted = false;
  settings.low_weight = false;
  alone.settings.Merge(id, settings);
  return AlignedMap{text, id, ViewOf(alone)};
}

// What is corrupt would be saved as whole.
absl::StatusOr<AlignedMaps> OpenMaps(const AlignFlags& flags) {
  const MapSourceFlags& source = flags.source;
  SPLINEMAP_ASSIGN_OR_RETURN(const auto words, ArgumentsAfterMap(source));
  if (words.size() != 2 && (!source.IsFile() || words.size() != 1)) {
    return InvalidArgument(
        "give two map files, or two layers after a map file, --live or --fleet; there are {} after "
        "it",
        words.size());
  }
  SPLINEMAP_ASSIGN_OR_RETURN(MapViewSource first, OpenMapView(source));
  AlignedMaps maps;
  maps.exit_status = first.exit_status;
  if (words.size() == 2) {
    const std::string where = source.live        ? "the bus"
                              : source.IsFleet() ? "the fleet's map"
                                                 : source.arguments.front();
    SPLINEMAP_ASSIGN_OR_RETURN(maps.a, LayerOf(first.layers, words[0], where));
    SPLINEMAP_ASSIGN_OR_RETURN(maps.b, LayerOf(first.layers, words[1], where));
    maps.layers = std::move(first.layers);
    maps.layers_of_b = {maps.b.layer};
  } else {
    SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap second, ReadMapFile(words[0]));
    maps.a.name = source.arguments.front();
    maps.a.view = std::move(first.map);
    maps.b.name = words[0];
    maps.b.view = ViewOf(second.set);
    maps.exit_status = std::max(maps.exit_status, ReportCorruption(second));
    for (const LayerSnapshot& layer : second.set.layers) maps.layers_of_b.push_back(layer.id);
    maps.layers = std::move(second.set);
  }
  if (flags.apply && maps.exit_status != kSuccess) {
    return DataLoss("a map is corrupt, and nothing is written; splinemap verify shows what");
  }
  return maps;
}

nlohmann::json JsonOf(const Pose2& pose) {
  return {{"x_m", pose.position_m.x()},
          {"y_m", pose.position_m.y()},
          {"yaw_deg", pose.yaw_rad / kDegree_rad}};
}

void PrintAsJson(const AlignedMaps& maps, const Alignment& found) {
  nlohmann::json json = JsonOf(found.a_T_b);
  json["a"] = maps.a.name;
  json["b"] = maps.b.name;
  json["overlap"] = found.overlap;
  json["overlap_m2"] = found.overlap_m2;
  json["agree_m"] = found.agree_m;
  json["contradict_m"] = found.contradict_m;
  json["score_m"] = found.score_m;
  json["residual_m"] = found.residual_m;
  json["covariance"] = nlohmann::json::array();
  for (int k = 0; k < 9; ++k) json["covariance"].push_back(found.covariance(k / 3, k % 3));
  json["runner_up"] = nullptr;
  if (found.runner_up) {
    json["runner_up"] = JsonOf(found.runner_up->a_T_b);
    json["runner_up"]["agree_m"] = found.runner_up->agree_m;
    json["runner_up"]["contradict_m"] = found.runner_up->contradict_m;
    json["runner_up"]["score_m"] = found.runner_up->score_m;
  }
  PrintJson(json);
}

// Without a -0.
double Rounded(double value, double unit) { return std::round(value / unit) * unit + 0.0; }

std::string WordsFor(const Pose2& pose) {
  return fmt::format("x {:.3f} m, y {:.3f} m, yaw {:.3f} degrees",
                     Rounded(pose.position_m.x(), 0.001), Rounded(pose.position_m.y(), 0.001),
                     Rounded(pose.yaw_rad / kDegree_rad, 0.001));
}

void PrintInWords(const AlignedMaps& maps, const Alignment& found) {
  PrintLine(stdout, "from the frame of {} to that of {}: {}", maps.b.name, maps.a.name,
            WordsFor(found.a_T_b));
  PrintLine(stdout, "standard deviations: {:.4f} m, {:.4f} m, {:.3f} degrees",
            std::sqrt(found.covariance(0, 0)), std::sqrt(found.covariance(1, 1)),
            std::sqrt(found.covariance(2, 2)) / kDegree_rad);
  PrintLine(
      stdout,
      "both know {:.0f} m2, {:.0f} % of the smaller map; {:.1f} m of walls agree, to {:.0f} mm, "
      "and {:.1f} m contradict",
      found.overlap_m2, 100 * found.overlap, found.agree_m, 1e3 * found.residual_m,
      found.contradict_m);
  if (found.runner_up) {
    PrintLine(stdout, "next best: {}, with {:.0f} % of the score", WordsFor(found.runner_up->a_T_b),
              100 * found.runner_up->score_m / found.score_m);
  }
}

absl::Status WritePicture(const AlignedMaps& maps, const Alignment& found,
                          const std::string& path) {
  constexpr int kSide = 1200;
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid,
                             GridAroundBoth(*maps.a.view, *maps.b.view, found.a_T_b, kSide));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
  SPLINEMAP_RETURN_IF_ERROR(
      WritePng(RenderBoth(*maps.a.view, *maps.b.view, found.a_T_b, grid), file));
  SPLINEMAP_RETURN_IF_ERROR(file.Commit());
  PrintLine(stderr, "{}: walls of {} are blue, of {} orange, of both black", path, maps.a.name,
            maps.b.name);
  return absl::OkStatus();
}

std::string TypedText(const FixedPose2& placement) {
  const TypedPlacement typed(placement);
  return fmt::format("{} {} {}", typed.x_m, typed.y_m, typed.yaw_deg);
}

void PrintPlaced(const LayerId& id, const FixedPose2& placement, const FixedPose2& before) {
  PrintLine(stderr, "place {} {}; it was at {}", NameOf(id), TypedText(placement),
            TypedText(before));
}

absl::Status ApplyToFile(const AlignFlags& flags, const Alignment& found, AlignedMaps& maps) {
  const LayerSet before = maps.layers;
  for (const LayerId& id : maps.layers_of_b) {
    const FixedPose2 placement = PlacementOf(*before.Find(id), before.settings.Of(id));
    SPLINEMAP_RETURN_IF_ERROR(
        EditLayer(LayerCommand::kPlace, found.a_T_b * placement.ToPose(), id, maps.layers));
  }
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(maps.layers, flags.output.path));
  for (const LayerId& id : maps.layers_of_b) {
    PrintPlaced(id, PlacementOf(*maps.layers.Find(id), maps.layers.settings.Of(id)),
                PlacementOf(*before.Find(id), before.settings.Of(id)));
  }
  return absl::OkStatus();
}

absl::Status PlacedMeanwhile(const LayerId& id) {
  return FailedPrecondition(
      "{} was placed or made anew meanwhile, so nothing was placed; try again", NameOf(id));
}

absl::Status ApplyLive(const AlignFlags& flags, const Alignment& found, const AlignedMaps& maps) {
  MapSourceFlags source = flags.source;
  source.robot.clear();  // names of layers are given
  source.bus.timeout_s = 2;
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<LiveLayer> now,
                             FindLiveLayers(source, {NameOf(maps.a.layer), NameOf(maps.b.layer)}));
  for (const LiveLayer& layer : now) {
    if (layer.session_number != maps.layers.Find(layer.id)->session.number ||
        layer.on_read != maps.layers.settings.Of(layer.id).placement) {
      return PlacedMeanwhile(layer.id);
    }
  }
  const LiveLayer& b = now.back();
  const Pose2 placement = found.a_T_b * b.placement.ToPose();
  SPLINEMAP_RETURN_IF_ERROR(EditLiveLayer(flags.source.bus, b, LayerCommand::kPlace, placement));
  PrintPlaced(b.id, FixedPose2::Nearest(placement), b.placement);
  return absl::OkStatus();
}

absl::Status ApplyToFleet(const AlignFlags& flags, const Alignment& found,
                          const AlignedMaps& maps) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto store, NatsFleetStore::Connect(flags.source.fleet));
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<FleetLayer> now,
                             FindFleetLayers(*store, {NameOf(maps.a.layer), NameOf(maps.b.layer)}));
  for (const FleetLayer& layer : now) {
    if (layer.session != maps.layers.Find(layer.id)->session ||
        layer.placement != maps.layers.settings.Of(layer.id).placement) {
      return PlacedMeanwhile(layer.id);
    }
  }
  const FleetLayer& b = now.back();
  const Pose2 placement = found.a_T_b * b.placement.ToPose();
  SPLINEMAP_RETURN_IF_ERROR(EditFleetLayer(*store, b, LayerCommand::kPlace, placement));
  PrintPlaced(b.id, FixedPose2::Nearest(placement), b.placement);
  return absl::OkStatus();
}

absl::Status Apply(const AlignFlags& flags, const Alignment& found, AlignedMaps& maps) {
  if (flags.source.live) return ApplyLive(flags, found, maps);
  if (flags.source.IsFleet()) return ApplyToFleet(flags, found, maps);
  return ApplyToFile(flags, found, maps);
}

absl::Status CheckOutputs(const AlignFlags& flags) {
  if (!flags.picture.empty()) {
    if (!flags.picture.ends_with(".png")) {
      return InvalidArgument("{} does not end in .png", flags.picture);
    }
    SPLINEMAP_RETURN_IF_ERROR(
        CheckOutput({flags.picture, flags.output.force}, flags.source.arguments));
  }
  if (!flags.apply || !flags.source.IsFile()) return absl::OkStatus();
  if (flags.output.path.empty()) return InvalidArgument("give the map file to write with --out");
  const auto path_of = [](const std::string& path) {
    return std::filesystem::absolute(path).lexically_normal();
  };
  if (!flags.picture.empty() && path_of(flags.picture) == path_of(flags.output.path)) {
    return InvalidArgument("the picture and the map are to be written to one file, {}",
                           flags.picture);
  }
  return CheckMapOutput(flags.output, flags.source.arguments);
}

absl::StatusOr<int> AlignMaps(const AlignFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutputs(flags));
  SPLINEMAP_ASSIGN_OR_RETURN(AlignedMaps maps, OpenMaps(flags));
  AlignOptions options = flags.options;
  std::optional<ProgressBar> bar("aligning");
  options.on_progress = [&](double share) { bar->Show(share); };
  SPLINEMAP_ASSIGN_OR_RETURN(const Alignment found, Align(*maps.a.view, *maps.b.view, options));
  bar.reset();
  if (flags.json) {
    PrintAsJson(maps, found);
  } else {
    PrintInWords(maps, found);
  }
  if (flags.apply) SPLINEMAP_RETURN_IF_ERROR(Apply(flags, found, maps));
  if (!flags.picture.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(WritePicture(maps, found, flags.picture));
  }
  return maps.exit_status;
}

constexpr const char* kAlignExamples = R"(
Examples:
  splinemap align monday.splinemap tuesday.splinemap
  splinemap align monday.splinemap tuesday.splinemap --json --picture both.png
  splinemap align fleet.splinemap robot-1 robot-2
  splinemap align --live robot-1 robot-2
  splinemap align monday.splinemap tuesday.splinemap --apply --out placed.splinemap
  splinemap align --live robot-1 robot-2 --apply
  splinemap align --fleet nats://hub --credentials operator robot-1 robot-2 --apply

Finds how B lies in the frame of A, without a guess, by the walls that both have and by the free
space of each in which the other has none. Prints the transform that takes points of B to A: turn by
yaw, counter-clockwise, then shift by x and y; how sure that is; and the next best place. The maps
may have different knot intervals. Layers are taken as they are placed in the map, also if they are
muted. --at is about the first map alone.
--apply places B, the layer or all layers of the file, in the frame of A, as splinemap layer place
does, with which they can be placed back to where they were, which it prints.
Refuses rather than guesses: where too little agrees, too much contradicts, the maps can slide as in
a corridor, one corner alone fits, or two places do as in a symmetric room or a row of equal rooms.
Floors that are built alike can deceive it; --picture shows what it found.
Exit status: 0 found; 1 refused, with the reason and the figures, or failed; 2 usage.)";

}  // namespace

void AddAlign(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<AlignFlags>();
  CLI::App* command =
      app.add_subcommand("align", "Find how two maps that overlap lie to each other");
  command->footer(kAlignExamples);
  AddMapViewSource(*command, "A B", "another one, or two layers", flags->source);
  AddJsonFlag(*command, flags->json);
  command
      ->add_option("--min-wall", flags->options.min_score_m,
                   "m of wall that have to agree, beyond twice what contradicts (default 15)")
      ->type_name("M")
      ->check(CLI::Range(0.01, 1e6));
  command
      ->add_option("--picture", flags->picture,
                   "Draw both maps: walls of A blue, of B orange, of both black")
      ->type_name("OUT.png");
  CLI::Option* apply = command->add_flag("--apply", flags->apply, "Place B where it was found")
                           ->excludes(command->get_option("--at"));
  AddOutOption(*command, "Map file to write: B as it was placed; for --apply", flags->output)
      ->needs(apply)
      ->excludes("--live", "--fleet");
  command->callback([flags, &chosen] { chosen = [flags] { return AlignMaps(*flags); }; });
}

}  // namespace splinemap
