#include <CLI/App.hpp>
#include <algorithm>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "lib/base/random.h"
#include "lib/base/status.h"
#include "lib/config/config.h"
#include "lib/exchange/ros_grid.h"
#include "splinemap/layer_set.h"

namespace splinemap {
namespace {

struct ImportRosFlags {
  std::string yaml;
  Output output;
  std::string name = "imported";
  std::string config_path;
  CellWeights weights;
};

void ReportCells(const RosGrid& grid, size_t tiles, const std::string& out) {
  int64_t occupied = 0;
  int64_t unknown = 0;
  for (const uint8_t per_cent : grid.per_cent) {
    unknown += per_cent == RosGrid::kUnknown ? 1 : 0;
    occupied += per_cent != RosGrid::kUnknown && per_cent > 50 ? 1 : 0;
  }
  PrintLine(stderr, "{} x {} cells of {} m, {} occupied, {} free, {} unknown; {} tiles in {}",
            grid.width, grid.height, grid.cell_m, occupied,
            static_cast<int64_t>(grid.per_cent.size()) - occupied - unknown, unknown, tiles, out);
}

absl::StatusOr<int> ImportRos(const ImportRosFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckRobotName(flags.name));
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.yaml}));
  config::Config config;
  if (!flags.config_path.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(config, LoadConfig(flags.config_path));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const RosGrid grid, ReadRosGrid(flags.yaml));
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {grid.image_path}));
  const MapOptions options = MapOptionsOf(config.method());
  SPLINEMAP_ASSIGN_OR_RETURN(const TileTree tiles, TilesOf(grid, flags.weights, options));
  if (tiles.size() == 0) {
    return FailedPrecondition("{} has no cell that is occupied or free; are its thresholds right?",
                              flags.yaml);
  }
  const LayerSnapshot layer{{flags.name, RandomId()}, {1, RandomId()}, 1, tiles};
  SPLINEMAP_RETURN_IF_ERROR(SaveAs({.options = options, .layers = {layer}}, flags.output.path));
  ReportCells(grid, tiles.size(), flags.output.path);
  return kSuccess;
}

constexpr const char* kImportRosExamples = R"(
Examples:
  splinemap import-ros lab.yaml lab.splinemap
  splinemapd --map lab.splinemap --scan LASER --pose POSE

Makes a map file with one layer of a map of ROS map_server: a .yaml with its PGM or PNG, in mode
trinary, scale or raw, also turned. Unknown stays unknown. The daemon maps into a layer of its own,
and the map is the sum of both. At the default weights a robot 3 m away has seen in 8 scans that a
wall is gone, and in 2 that there is one. Each import is a layer of its own: merged with an earlier
import of the same map it counts twice. Knot interval and clamps are those of --config, which has to
be the daemon's.)";

}  // namespace

void AddImportRos(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<ImportRosFlags>();
  CLI::App* command = app.add_subcommand("import-ros", "Make a map of one of ROS map_server");
  command->footer(kImportRosExamples);
  command->add_option("MAP.yaml", flags->yaml, "Map of map_server")->required();
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  command->add_option("--name", flags->name, "Name of the layer (default imported)");
  command
      ->add_option("--occupied-log-odds", flags->weights.occupied_log_odds,
                   "Weight of occupied cells (default 3.2)")
      ->check(CLI::Range(0.1, 127.0));
  command
      ->add_option("--free-log-odds", flags->weights.free_log_odds,
                   "Weight of free cells (default -2.5)")
      ->check(CLI::Range(-127.0, -0.1));
  command->add_option("--config", flags->config_path, "Configuration of the daemon")
      ->type_name("FILE");
  command->callback([flags, &chosen] { chosen = [flags] { return ImportRos(*flags); }; });
}

}  // namespace splinemap
