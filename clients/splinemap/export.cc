#include <CLI/App.hpp>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "absl/strings/match.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/print.h"
#include "lib/config/region_flag.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/exchange/csv.h"
#include "lib/exchange/geotiff.h"
#include "lib/exchange/ros_map.h"
#include "lib/exchange/world_file.h"
#include "lib/render/raster.h"
#include "splinemap/map_view.h"

namespace splinemap {
namespace {

struct ExportFlags {
  MapSourceFlags source;
  std::string format;
  std::string mode;
  std::string region;
  std::optional<double> resolution_m;
  bool force = false;
};

RosMode ParseMode(const std::string& mode) {
  return mode == "scale" ? RosMode::kScale : mode == "raw" ? RosMode::kRaw : RosMode::kTrinary;
}

std::vector<std::string> Extensions(const ExportFlags& flags, RosMode mode) {
  if (flags.format == "ros") return {RosImageExtension(mode), ".yaml"};
  if (flags.format == "png") return {".png", ".pgw"};
  if (flags.format == "csv") return {".csv"};
  return {".tif"};
}

// `base` without an extension that the user typed.
std::string WithoutExtension(std::string base, const std::vector<std::string>& extensions) {
  for (const std::string& extension : extensions) {
    if (absl::EndsWithIgnoreCase(base, extension)) {
      base.resize(base.size() - extension.size());
      break;
    }
  }
  return base;
}

// `files` are those of Extensions().
absl::Status Write(const ExportFlags& flags, RosMode mode, const MapView& map,
                   const PixelGrid& grid, std::vector<NewFile>& files) {
  if (flags.format == "ros") {
    const std::string image = std::filesystem::path(files[0].path()).filename().string();
    SPLINEMAP_ASSIGN_OR_RETURN(const std::string yaml, RosYaml(grid, mode, image));
    SPLINEMAP_RETURN_IF_ERROR(WriteRosImage(map, grid, mode, files[0]));
    return files[1].Write(yaml);
  }
  if (flags.format == "png") {
    SPLINEMAP_RETURN_IF_ERROR(WritePng(RenderMap(map, grid), files[0]));
    return files[1].Write(WorldFile(grid));
  }
  if (flags.format == "csv") return WriteCsv(map, grid, files[0]);
  return WriteGeoTiff(map, grid, files[0]);
}

// The files to write, each of which may be.
absl::StatusOr<std::vector<std::string>> OutputsOf(const ExportFlags& flags, RosMode mode) {
  SPLINEMAP_ASSIGN_OR_RETURN(const std::string given, OutputAfterMap(flags.source));
  const std::vector<std::string> extensions = Extensions(flags, mode);
  const std::string base = WithoutExtension(given, extensions);
  if (std::filesystem::path(base).filename().empty()) {
    return InvalidArgument("BASE is {}; add the name of the files", given);
  }
  std::vector<std::string> paths;
  for (const std::string& extension : extensions) {
    paths.push_back(base + extension);
    SPLINEMAP_RETURN_IF_ERROR(CheckOutput({paths.back(), flags.force}, MapFilesOf(flags.source)));
  }
  return paths;
}

absl::StatusOr<int> Export(const ExportFlags& flags) {
  if (!flags.mode.empty() && flags.format != "ros") {
    return InvalidArgument("--mode requires --format ros");
  }
  const RosMode mode = ParseMode(flags.mode);
  SPLINEMAP_ASSIGN_OR_RETURN(const std::optional<Region> region, ParseRegion(flags.region));
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<std::string> paths, OutputsOf(flags, mode));
  SPLINEMAP_ASSIGN_OR_RETURN(const MapViewSource source, OpenMapView(flags.source));
  const MapView& map = *source.map;
  SPLINEMAP_ASSIGN_OR_RETURN(
      const PixelGrid grid,
      GridOfRegion(map, region, flags.resolution_m.value_or(map.options.knot_interval_m)));
  // All are written before the first takes its name: none describes another's predecessor.
  std::vector<NewFile> files;
  for (const std::string& path : paths) {
    SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
    files.push_back(std::move(file));
  }
  SPLINEMAP_RETURN_IF_ERROR(Write(flags, mode, map, grid, files));
  for (NewFile& file : files) SPLINEMAP_RETURN_IF_ERROR(file.Commit());
  PrintLine(stderr, "{}: {} x {} pixels of {} m, lower left corner at {}, {} m",
            fmt::join(paths, ", "), grid.width, grid.height, grid.pixel_m, grid.left_m,
            grid.bottom_m());
  return source.exit_status;
}

constexpr const char* kExportExamples = R"(
Examples:
  splinemap export lab.splinemap lab --format ros
  splinemap export --live lab --format ros
  splinemap export lab.splinemap door --format geotiff --region -2,0,3.5,4 --resolution 0.01

Evaluates the surface at the centre of every pixel. Centres are whole multiples of the resolution,
so at the knot interval they are the control points, and pictures of one resolution fit together. A
pixel belongs to the region that contains its centre; the lower and left edges are included.

  ros      BASE.pgm and BASE.yaml for map_server and nav2_map_server. --mode trinary: occupied above
           a probability of 0.65, free below 0.196, else unknown. --mode scale and raw: the
           probability in per cent; scale writes BASE.png, in which unknown is transparent.
  png      The picture of render, and BASE.pgw, a world file with its place.
  csv      A line x_m,y_m,log_odds,probability,known per pixel, from the lower left, x fastest.
  geotiff  BASE.tif: log-odds of occupied as float32, NaN (nodata) where unknown, in metres of the
           map frame.)";

}  // namespace

void AddExport(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<ExportFlags>();
  CLI::App* command =
      app.add_subcommand("export", "Convert a map for ROS, or to PNG, CSV or GeoTIFF");
  command->footer(kExportExamples);
  AddMapViewSource(*command, "MAP BASE", "the files to write, without extension", flags->source);
  command->add_option("--format", flags->format, "ros, png, csv or geotiff")
      ->required()
      ->check(CLI::IsMember({"ros", "png", "csv", "geotiff"}));
  command->add_option("--mode", flags->mode, "trinary, scale or raw, of ros (default trinary)")
      ->check(CLI::IsMember({"trinary", "scale", "raw"}));
  AddRegionFlag(*command, flags->region);
  command->add_option("--resolution", flags->resolution_m,
                      "m, side of a pixel (default: the knot interval)");
  AddForceFlag(*command, flags->force);
  command->callback([flags, &chosen] { chosen = [flags] { return Export(*flags); }; });
}

}  // namespace splinemap
