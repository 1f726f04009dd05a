#include "lib/render/raster.h"

#include <cmath>
#include <iterator>
#include <memory>
#include <optional>
#include <string>

#include "absl/strings/match.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/region_flag.h"
#include "clients/splinemap/say.h"
#include "lib/base/file.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct RasterFlags {
  MapSourceFlags asked;
  std::string region;
  double resolution_m = 0.05;
  bool force = false;
};

// Pixels from the top, cells from the lowest y.
int16_t CellAt(const RasterQuery::Answer& answer, const PixelGrid& grid, int column, int row) {
  return answer.cells[size_t{1} * (grid.height - 1 - row) * grid.width + column];
}

double LogOdds(int16_t cell) { return cell / double{kUnitsPerLogOdds}; }

Raster ToRaster(const RasterQuery::Answer& answer, const PixelGrid& grid) {
  Raster raster;
  raster.grid = grid;
  raster.pixels.reserve(answer.cells.size());
  for (int row = 0; row < grid.height; ++row) {
    for (int column = 0; column < grid.width; ++column) {
      const int16_t cell = CellAt(answer, grid, column, row);
      raster.pixels.push_back(cell == 0 ? Raster::kUnknown : KnownPixel(LogOdds(cell)));
    }
  }
  return raster;
}

// As export does.
absl::Status WriteCells(const RasterQuery::Answer& answer, const PixelGrid& grid, NewFile& file) {
  constexpr size_t kBlock = 1 << 16;
  std::string text = "x_m,y_m,log_odds,probability,known\n";
  for (int row = grid.height - 1; row >= 0; --row) {
    for (int column = 0; column < grid.width; ++column) {
      const int16_t cell = CellAt(answer, grid, column, row);
      fmt::format_to(std::back_inserter(text), "{},{},{:.6f},{:.6f},{}\n", grid.CentreX(column),
                     grid.CentreY(row), LogOdds(cell), Probability(LogOdds(cell)),
                     cell != 0 ? 1 : 0);
      if (text.size() < kBlock) continue;
      SPLINEMAP_RETURN_IF_ERROR(file.Write(text));
      text.clear();
    }
  }
  return file.Write(text);
}

absl::StatusOr<int> AskRaster(const RasterFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto words, WordsAfterMap(flags.asked));
  if (words.size() != 1) {
    return InvalidArgument("give one file to write, after {}",
                           flags.asked.live ? "no map file with --live" : "the map file");
  }
  const std::string& out = words[0];
  const bool is_csv = absl::EndsWith(out, ".csv");
  if (!is_csv && !absl::EndsWith(out, ".png")) {
    return InvalidArgument("{}: give it a name that ends in .png or .csv", out);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::optional<Region> region, ParseRegion(flags.region));
  // The knot interval of a daemon's map is not known; its default limits region and resolution.
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid,
                             GridOfRegion(MapView(), region, flags.resolution_m));
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(out, flags.force));
  RasterQuery query;
  query.first_m = {grid.CentreX(0), grid.CentreY(grid.height - 1)};
  query.resolution_m = grid.pixel_m;
  query.width = grid.width;
  query.height = grid.height;
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSource asked, OpenMapSource(flags.asked));
  SPLINEMAP_ASSIGN_OR_RETURN(const RasterQuery::Answer answer, asked.map->Ask(query));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(out));
  SPLINEMAP_RETURN_IF_ERROR(is_csv ? WriteCells(answer, grid, file)
                                   : WritePng(ToRaster(answer, grid), file));
  SPLINEMAP_RETURN_IF_ERROR(file.Commit());
  Say(stderr, "{}: {} x {} pixels of {} m, lower left corner at {}, {} m", out, grid.width,
      grid.height, grid.pixel_m, grid.left_m, grid.bottom_m());
  return asked.exit_status;
}

constexpr const char* kRasterExamples = R"(
Examples:
  splinemap raster lab.splinemap door.png --region -2,0,3.5,4 --resolution 0.01
  splinemap raster --live around.csv --region -2,0,3.5,4

Asks for the surface at the centre of every pixel, to 1/256 log-odds; pixels lie as those of
splinemap export. A .png has the colours of splinemap render; a .csv is
x_m,y_m,log_odds,probability,known for every pixel, from the lower left, x fastest. Large rasters
over a bus take more time: see --timeout.)";

}  // namespace

void AddRaster(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RasterFlags>();
  CLI::App* command = app.add_subcommand("raster", "A part of a map as pixels");
  command->footer(kRasterExamples);
  AddAskedMapFlags(*command, "MAP_OUT", "file to write, .png or .csv", flags->asked);
  command->add_option("--region", flags->region, "x0,y0,x1,y1 in metres of the map frame")
      ->required()
      ->type_name("REGION");
  command->add_option("--resolution", flags->resolution_m, "Metres per pixel (default 0.05)");
  command->add_flag("--force", flags->force, "Replace a file that exists");
  command->callback([flags, &chosen] { chosen = [flags] { return AskRaster(*flags); }; });
}

}  // namespace splinemap
