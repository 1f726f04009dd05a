#include "lib/render/raster.h"

#include <CLI/App.hpp>
#include <iterator>
#include <memory>
#include <optional>
#include <string>

#include "absl/strings/match.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
#include "lib/config/region_flag.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "splinemap/queryable_map.h"

namespace splinemap {
namespace {

struct RasterFlags {
  MapSourceFlags source;
  std::string region;
  double resolution_m = 0.05;
  Output output;
};

// Pixels are counted from the top, cells from the lowest y.
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

absl::StatusOr<int> WriteRaster(RasterFlags flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(flags.output.path, OutputAfterMap(flags.source));
  const std::string& out = flags.output.path;
  const bool is_csv = absl::EndsWith(out, ".csv");
  if (!is_csv && !absl::EndsWith(out, ".png")) {
    return InvalidArgument("{} does not end in .png or .csv", out);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::optional<Region> region, ParseRegion(flags.region));
  // The knot interval of a daemon's map is not known; its default limits region and resolution.
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid,
                             GridOfRegion(MapView(), region, flags.resolution_m));
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.output, MapFilesOf(flags.source)));
  RasterQuery query;
  query.first_m = {grid.CentreX(0), grid.CentreY(grid.height - 1)};
  query.resolution_m = grid.pixel_m;
  query.width = grid.width;
  query.height = grid.height;
  SPLINEMAP_ASSIGN_OR_RETURN(const MapSource source, OpenMapSource(flags.source));
  SPLINEMAP_ASSIGN_OR_RETURN(const RasterQuery::Answer answer, source.map->Ask(query));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(out));
  SPLINEMAP_RETURN_IF_ERROR(is_csv ? WriteCells(answer, grid, file)
                                   : WritePng(ToRaster(answer, grid), file));
  SPLINEMAP_RETURN_IF_ERROR(file.Commit());
  PrintLine(stderr, "{}: {} x {} pixels of {} m, lower left corner at {}, {} m", out, grid.width,
            grid.height, grid.pixel_m, grid.left_m, grid.bottom_m());
  return source.exit_status;
}

constexpr const char* kRasterExamples = R"(
Examples:
  splinemap raster lab.splinemap door.png --region -2,0,3.5,4 --resolution 0.01
  splinemap raster --live around.csv --region -2,0,3.5,4

Queries the surface at the centre of every pixel, rounded to 1/256 log-odds, on the pixel grid of
splinemap export. A .png has the colours of splinemap render. A .csv has a line
x_m,y_m,log_odds,probability,known for every pixel, from the lower left, x fastest. A large raster
may need a larger --timeout.)";

}  // namespace

void AddRaster(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RasterFlags>();
  CLI::App* command = app.add_subcommand("raster", "Write part of a map as pixels");
  command->footer(kRasterExamples);
  AddMapSource(*command, "MAP OUT", "the file to write, .png or .csv", flags->source);
  AddRegionFlag(*command, flags->region)->required();
  command->add_option("--resolution", flags->resolution_m, "m, side of a pixel (default 0.05)");
  AddForceFlag(*command, flags->output.force);
  command->callback([flags, &chosen] { chosen = [flags] { return WriteRaster(*flags); }; });
}

}  // namespace splinemap
