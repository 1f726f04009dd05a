#include <CLI/App.hpp>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/follow.h"
#include "clients/splinemap/follow_fleet.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/layer_rows.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/progress.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet_flags.h"
#include "lib/layers/layer_union.h"
#include "lib/map/contradictions.h"
#include "lib/map/summed_layers.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct MergeFlags {
  std::vector<std::string> maps;
  FleetAddress fleet;
  BusFlags bus;  // the timeout alone, of the fleet
  Output output;
  bool accepts_corrupt = false;
};

double Bytes(const std::string& path) {
  std::error_code error;
  const auto bytes = std::filesystem::file_size(path, error);
  return error ? 0 : static_cast<double>(bytes);
}

absl::Status CheckOptions(const MapOptions& options, const std::string& path,
                          const MapOptions& others, const std::string& other_path) {
  constexpr double kUnits = kUnitsPerLogOdds;
  const auto differ = [&](const std::string& what, const std::string& a, const std::string& b) {
    return InvalidArgument("{} of {} are {}, and those of {} are {}; such maps cannot be summed",
                           what, path, a, other_path, b);
  };
  if (options.knot_interval_m != others.knot_interval_m) {
    return differ("knot intervals", fmt::format("{} m", options.knot_interval_m),
                  fmt::format("{} m", others.knot_interval_m));
  }
  if (options.limits != others.limits) {
    const auto text = [&](ControlLimits limits) {
      return fmt::format("{} .. {} log-odds", limits.min / kUnits, limits.max / kUnits);
    };
    return differ("clamps", text(options.limits), text(others.limits));
  }
  return absl::OkStatus();
}

// Merges files, which it is given one after the other.
class Merger {
 public:
  absl::Status Add(const std::string& path, const LayerSet& map) {
    if (!union_) {
      union_.emplace(map.options);
      options_ = {map.options, path};
    }
    SPLINEMAP_RETURN_IF_ERROR(CheckOptions(map.options, path, options_.first, options_.second));
    const auto conflicts = union_->Add(map);
    if (!conflicts.ok()) return FailedPrecondition("{}: {}", path, ErrorText(conflicts.status()));
    for (const LayerSnapshot& layer : map.layers) sources_.try_emplace(layer.id, path);
    for (const LayerUnion::Conflict& conflict : *conflicts) Note(path, conflict);
    return absl::OkStatus();
  }

  LayerSet Layers() const { return union_->Layers(); }

  // Prints what people may not expect. False where copies of a layer conflict.
  bool Report(const LayerSet& merged) const {
    for (const std::string& note : notes_) PrintLine(stderr, "{}", note);
    for (const LayerId& id : union_->Removed()) {
      PrintLine(stderr, "{} is left out: {}", NameOf(id),
                TextOf(merged.settings.Of(id), FixedPose2(), /*is_there=*/false));
    }
    std::map<std::string, std::vector<std::string>> names;
    for (const LayerSnapshot& layer : merged.layers) {
      names[layer.id.name].push_back(NameOf(layer.id));
    }
    for (const auto& [name, layers] : names) {
      if (layers.size() == 1) continue;
      PrintLine(
          stderr,
          "{} stay apart; they come from two robots of one name, a new computer or a new map file",
          fmt::join(layers, " and "));
    }
    return !has_conflicts_;
  }

  // Warns of layers whose obstacles are where the others saw free space.
  void ReportContradictions(const LayerSet& merged, const MapView& sum) const {
    for (const auto& [id, contradiction] : ContradictionsOf(merged, sum)) {
      if (!contradiction.IsTooMuch()) continue;
      PrintLine(stderr,
                "warning: {} of {} are where the others saw free space; its frame may be another, "
                "and the sum loses walls. splinemap render --contradictions shows where, splinemap "
                "layer places or mutes it",
                ObstaclesText(contradiction), NameOf(id));
    }
  }

 private:
  void Note(const std::string& path, const LayerUnion::Conflict& conflict) {
    std::string& source = sources_.at(conflict.id);
    const std::string name = NameOf(conflict.id);
    if (conflict.conflicting_tiles > 0) {
      has_conflicts_ = true;
      notes_.push_back(fmt::format(
          "{}: {} tiles of {} differ from those of {} at the same commit, since two daemons used "
          "one copied file; one of each is kept, the same in any order of files",
          name, conflict.conflicting_tiles, path, source));
      return;
    }
    notes_.push_back(fmt::format("{}: session {} in {} replaces session {} in {}{}", name,
                                 conflict.kept.number, conflict.is_map_newer ? path : source,
                                 conflict.dropped.number, conflict.is_map_newer ? source : path,
                                 conflict.kept.number == conflict.dropped.number
                                     ? ", since two daemons used one copied file"
                                     : ""));
    if (conflict.is_map_newer) source = path;
  }

  std::optional<LayerUnion> union_;
  std::pair<MapOptions, std::string> options_;  // and the file that has them
  std::map<LayerId, std::string> sources_;      // the first file that has the layer's session
  std::vector<std::string> notes_;
  bool has_conflicts_ = false;
};

// Returns the exit status of a command that else succeeded.
absl::StatusOr<int> AddFleet(const MergeFlags& flags, Merger& merger) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FollowedFleet fleet,
                             FollowWholeFleet(flags.fleet, {}, flags.bus.Timeout()));
  SPLINEMAP_RETURN_IF_ERROR(merger.Add(fmt::format("the fleet's map '{}'", flags.fleet.map),
                                       fleet.replica->WholeLayers()));
  return ReportRefused(fleet.replica->Refused());
}

absl::StatusOr<int> Merge(const MergeFlags& flags) {
  const bool has_fleet = !flags.fleet.servers.empty();
  if (flags.maps.empty() && !has_fleet) {
    return InvalidArgument("give the map files to merge, or --fleet, or both");
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, flags.maps));
  double all_bytes = 0;
  for (const std::string& path : flags.maps) all_bytes += Bytes(path);
  Merger merger;
  bool is_whole = true;
  if (has_fleet) {
    SPLINEMAP_ASSIGN_OR_RETURN(const int status, AddFleet(flags, merger));
    is_whole = status == kSuccess;
  }
  {
    ProgressBar bar("merging");
    double bytes = 0;
    for (const std::string& path : flags.maps) {
      SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(path));
      if (!loaded.corruption.empty()) bar.Hide();
      SPLINEMAP_RETURN_IF_ERROR(CheckInput(loaded, path, flags.accepts_corrupt));
      SPLINEMAP_RETURN_IF_ERROR(merger.Add(path, loaded.set));
      is_whole = is_whole && loaded.corruption.empty();
      bytes += Bytes(path);
      bar.Show(bytes / all_bytes);
    }
  }
  const LayerSet merged = merger.Layers();
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(merged, flags.output.path));
  const bool is_consistent = merger.Report(merged);
  const auto sum = ViewOf(merged);
  merger.ReportContradictions(merged, *sum);
  PrintLine(stderr, "merged {} maps: {} layers, {} tiles in {}",
            flags.maps.size() + (has_fleet ? 1 : 0), merged.layers.size(), sum->tiles.size(),
            flags.output.path);
  return is_whole && is_consistent ? kSuccess : kFailed;
}

constexpr const char* kMergeExamples = R"(
Examples:
  splinemap merge robot-1.splinemap robot-2.splinemap --out both.splinemap
  splinemap merge both.splinemap robot-*.splinemap -o fleet.splinemap
  splinemap merge --fleet nats://hub robot-7.splinemap -o with_robot_7.splinemap

Writes the layers of all files, each in its newest state; the map is their sum. The layers stay
apart in the file, so that merged files can be merged again: the order of files, their grouping and
repeated files make no difference. With --fleet the layers of a fleet are merged, too. The maps
must share a frame, a knot interval and clamps; merge warns where 20 % of the obstacles of a layer
are where the others saw free space. Exit status: 0 merged; 1 failed, or merged with conflicting
copies of a layer; 2 usage.)";

}  // namespace

void AddMerge(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<MergeFlags>();
  flags->bus.timeout_s = kCatchUpTimeout_s;
  CLI::App* command = app.add_subcommand("merge", "Merge the layers of several map files");
  command->footer(kMergeExamples);
  command->add_option("MAP", flags->maps, "Map files; may be left out with --fleet");
  CLI::Option* const fleet = AddFleetFlags(*command, flags->fleet);
  AddTimeoutFlag(*command, flags->bus)->needs(fleet)->group("With --fleet");
  AddOutOption(*command, "Map file to write", flags->output)->required();
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return Merge(*flags); }; });
}

}  // namespace splinemap
