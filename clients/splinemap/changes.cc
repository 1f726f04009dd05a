#include <CLI/App.hpp>
#include <algorithm>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "clients/splinemap/time_flag.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/map/occupancy_changes.h"
#include "lib/map/summed_layers.h"
#include "lib/render/raster.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct ChangesFlags {
  std::string map, since;
  Output picture;
  bool json = false;
};

Region SquareOf(Knot knot, double knot_m) {
  return {(knot.i - 0.5) * knot_m, (knot.j - 0.5) * knot_m, (knot.i + 0.5) * knot_m,
          (knot.j + 0.5) * knot_m};
}

absl::Status DrawChanges(const MapView& map, const std::vector<OccupancyChange>& changes,
                         const std::string& path) {
  constexpr int kSide = 1200;
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid,
                             FittingGrid(map, std::max(1.0, FittingPixelsPerKnot(map, kSide))));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
  Raster raster = RenderMap(map, grid);
  for (const OccupancyChange& change : changes) {
    for (const Knot knot : change.knots) {
      raster.Mark(SquareOf(knot, map.options.knot_interval_m),
                  change.is_occupied ? Raster::Marker::kRed : Raster::Marker::kGreen);
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(WritePng(raster, file));
  return file.Commit();
}

absl::StatusOr<int> Changes(const ChangesFlags& flags) {
  if (!flags.picture.path.empty())
    SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.picture, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.map));
  LayerSet before = loaded.set;
  SPLINEMAP_RETURN_IF_ERROR(WindBack(before, flags.since));
  const auto now = ViewOf(loaded.set);
  const std::vector<OccupancyChange> changes = OccupancyChanges(*ViewOf(before), *now);
  const double knot_m = now->options.knot_interval_m;
  nlohmann::json rows = nlohmann::json::array();
  if (!flags.json) PrintLine(stdout, "became,x0_m,y0_m,x1_m,y1_m,area_m2");
  for (const OccupancyChange& change : changes) {
    const Region& region = change.region;
    const double area_m2 = static_cast<double>(change.knots.size()) * knot_m * knot_m;
    const char* const became = change.is_occupied ? "occupied" : "free";
    rows.push_back({{"became", became},
                    {"region_m", {region.x0_m, region.y0_m, region.x1_m, region.y1_m}},
                    {"area_m2", area_m2}});
    if (flags.json) continue;
    PrintLine(stdout, "{},{:.3f},{:.3f},{:.3f},{:.3f},{:.4f}", became, region.x0_m, region.y0_m,
              region.x1_m, region.y1_m, area_m2);
  }
  if (flags.json) PrintJson({{"changes", rows}});
  if (!flags.picture.path.empty()) {
    SPLINEMAP_RETURN_IF_ERROR(DrawChanges(*now, changes, flags.picture.path));
    PrintLine(stderr, "{}: the map now; red became occupied, green became free",
              flags.picture.path);
  }
  return ReportCorruption(loaded);
}

}  // namespace

void AddChanges(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<ChangesFlags>();
  CLI::App* command =
      app.add_subcommand("changes", "What became occupied or free in a map since a time");
  command->footer(
      std::string("\nExamples:\n  splinemap changes lab.splinemap --since end-1h\n  splinemap "
                  "changes lab.splinemap --since 2026-11-28 --picture changes.png\n\nThe map as it "
                  "was is made of the scans that the file keeps.") +
      kTimeFooter);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("--since", flags->since, "What is compared with now")
      ->type_name("TIME")
      ->required();
  command->add_option("--picture", flags->picture.path, "The .png to write")->type_name("OUT");
  AddForceFlag(*command, flags->picture.force);
  AddJsonFlag(*command, flags->json);
  command->callback([flags, &chosen] { chosen = [flags] { return Changes(*flags); }; });
}

}  // namespace splinemap
