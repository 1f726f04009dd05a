#include "lib/matching/align.h"

#include <CLI/App.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "clients/splinemap/bus_flags.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/follow.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/print.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/map/summed_layers.h"
#include "lib/render/overlay.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

constexpr double kDegree_rad = std::numbers::pi / 180;

struct AlignFlags {
  std::vector<std::string> arguments;  // two maps, or a map (unless live) and two layers
  bool live = false;
  BusFlags bus;
  AlignOptions options;
  Output picture;
  bool json = false;
};

// A map, or one layer of a map, and what people call it.
struct AlignedMap {
  std::string name;
  std::shared_ptr<const MapView> view;
};

struct AlignedMaps {
  AlignedMap a;
  AlignedMap b;
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
  return AlignedMap{text, ViewOf(alone)};
}

absl::StatusOr<AlignedMaps> TwoLayers(const LayerSet& set, const std::string& a,
                                      const std::string& b, const std::string& where,
                                      int exit_status) {
  SPLINEMAP_ASSIGN_OR_RETURN(AlignedMap layer_a, LayerOf(set, a, where));
  SPLINEMAP_ASSIGN_OR_RETURN(AlignedMap layer_b, LayerOf(set, b, where));
  return AlignedMaps{std::move(layer_a), std::move(layer_b), exit_status};
}

absl::StatusOr<AlignedMaps> OpenMaps(const AlignFlags& flags) {
  const std::vector<std::string>& words = flags.arguments;
  if (flags.live) {
    if (words.size() != 2) return InvalidArgument("give two layers after --live");
    FollowOptions options;
    for (const std::string& word : words) options.names.push_back(word.substr(0, word.find('@')));
    SPLINEMAP_ASSIGN_OR_RETURN(const auto replica, FollowUntilCaughtUp(flags.bus, options));
    return TwoLayers(replica->SyncedLayers(), words[0], words[1], "the bus",
                     ReportRefused(*replica));
  }
  if (words.size() != 2 && words.size() != 3) {
    return InvalidArgument("give two map files, or one and two of its layers");
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap first, ReadMapFile(words[0]));
  const int of_first = ReportCorruption(first);
  if (words.size() == 3) return TwoLayers(first.set, words[1], words[2], words[0], of_first);
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap second, ReadMapFile(words[1]));
  return AlignedMaps{{words[0], ViewOf(first.set)},
                     {words[1], ViewOf(second.set)},
                     std::max(of_first, ReportCorruption(second))};
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
    json["runner_up"]["score_m"] = found.runner_up->score_m;
  }
  PrintJson(json);
}

// Without a -0.
double Rounded(double value, double unit) { return std::round(value / unit) * unit + 0.0; }

std::string WordsFor(const Pose2& pose) {
  return fmt::format("x {:.3f} m, y {:.3f} m, yaw {:.2f} degrees",
                     Rounded(pose.position_m.x(), 0.001), Rounded(pose.position_m.y(), 0.001),
                     Rounded(pose.yaw_rad / kDegree_rad, 0.01));
}

void PrintInWords(const AlignedMaps& maps, const Alignment& found) {
  PrintLine(stdout, "from the frame of {} to that of {}: {}", maps.b.name, maps.a.name,
            WordsFor(found.a_T_b));
  PrintLine(stdout, "standard deviations: {:.3f} m, {:.3f} m, {:.2f} degrees",
            std::sqrt(found.covariance(0, 0)), std::sqrt(found.covariance(1, 1)),
            std::sqrt(found.covariance(2, 2)) / kDegree_rad);
  PrintLine(stdout,
            "both know {:.0f} m2; {:.1f} m of walls agree, to {:.0f} mm, and {:.1f} m contradict",
            found.overlap_m2, found.agree_m, 1e3 * found.residual_m, found.contradict_m);
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

absl::StatusOr<int> AlignMaps(const AlignFlags& flags) {
  if (!flags.picture.path.empty()) {
    if (!flags.picture.path.ends_with(".png")) {
      return InvalidArgument("{} does not end in .png", flags.picture.path);
    }
    SPLINEMAP_RETURN_IF_ERROR(
        CheckOutput(flags.picture, flags.live ? std::vector<std::string>() : flags.arguments));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const AlignedMaps maps, OpenMaps(flags));
  SPLINEMAP_ASSIGN_OR_RETURN(const Alignment found,
                             Align(*maps.a.view, *maps.b.view, flags.options));
  if (flags.json) {
    PrintAsJson(maps, found);
  } else {
    PrintInWords(maps, found);
  }
  if (!flags.picture.path.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(WritePicture(maps, found, flags.picture.path));
  }
  return maps.exit_status;
}

constexpr const char* kAlignExamples = R"(
Examples:
  splinemap align monday.splinemap tuesday.splinemap
  splinemap align monday.splinemap tuesday.splinemap --json --picture both.png
  splinemap align fleet.splinemap robot-1 robot-2
  splinemap align --live robot-1 robot-2

Finds how B lies in the frame of A, without a guess, by the walls that both have and by the free
space of each in which the other has none. Prints the transform that takes points of B to A: turn by
yaw, counter-clockwise, then shift by x and y; how sure that is; and the next best place. The maps
may have different knot intervals. Layers are taken as they are placed in the map, also if they are
muted. Refuses rather than guesses: where too little agrees, too much contradicts, the maps can
slide as in a corridor, or two places fit alike as in a symmetric room. Buildings whose floors or
rooms are alike can deceive it: look at the --picture.
Exit status: 0 found; 1 refused, with the reason and the figures, or failed; 2 usage.)";

}  // namespace

void AddAlign(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<AlignFlags>();
  flags->bus.timeout_s = kCatchUpTimeout_s;
  CLI::App* command =
      app.add_subcommand("align", "Find how two maps that overlap lie to each other");
  command->footer(kAlignExamples);
  command->add_option(
      "A B", flags->arguments,
      "Two map files; or a map file and two of its layers; or --live and two layers");
  CLI::Option* const live =
      command->add_flag("--live", flags->live, "Align layers of the daemons on an LCM bus");
  AddBusFlags(*command, flags->bus, live);
  AddTimeoutFlag(*command, flags->bus, live);
  AddJsonFlag(*command, flags->json);
  command
      ->add_option("--min-wall", flags->options.min_score_m,
                   "m of wall that have to agree, beyond twice what contradicts (default 300 of "
                   "the wider knot interval)")
      ->type_name("M")
      ->check(CLI::Range(0.01, 1e6));
  command
      ->add_option("--picture", flags->picture.path,
                   "Draw both maps: walls of A blue, of B orange, of both black")
      ->type_name("OUT.png");
  AddForceFlag(*command, flags->picture.force);
  command->callback([flags, &chosen] { chosen = [flags] { return AlignMaps(*flags); }; });
}

}  // namespace splinemap
