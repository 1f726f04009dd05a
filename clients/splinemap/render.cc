#include <CLI/App.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/map_source.h"
#include "clients/splinemap/preview.h"
#include "clients/splinemap/print.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/map/contradictions.h"
#include "lib/render/map_parts.h"
#include "lib/render/raster.h"
#include "splinemap/region.h"

namespace splinemap {
namespace {

struct RenderFlags {
  MapSourceFlags source;
  Output output;
  double pixels_per_knot = 0;  // 0: to fit
  bool marks_contradictions = false;
};

// Marks where one layer has obstacles and the others saw free space.
void MarkContradictions(const MapViewSource& source, Raster& raster) {
  const double knot_m = source.layers.options.knot_interval_m;
  int64_t points = 0;
  VisitComparedPoints(
      source.layers, *source.map, [&](const LayerId&, int32_t i, int32_t j, bool is_contradicted) {
        if (!is_contradicted) return;
        ++points;
        raster.Mark(
            {(i - 0.5) * knot_m, (j - 0.5) * knot_m, (i + 0.5) * knot_m, (j + 0.5) * knot_m});
      });
  PrintLine(stderr, "{} control points are obstacles of one layer where the others saw free space",
            points);
}

std::string TextOf(const Region& region) {
  return fmt::format("{:.0f},{:.0f},{:.0f},{:.0f}", std::floor(region.x0_m),
                     std::floor(region.y0_m), std::ceil(region.x1_m), std::ceil(region.y1_m));
}

// Parts that are far apart become dots, or make the picture too large. Says where they lie.
void ReportParts(const MapSourceFlags& source, const MapView& map) {
  constexpr size_t kMaxLines = 5;
  constexpr int kFar = 10;  // the picture has so many times the side of its largest part
  const std::vector<MapPart> parts = PartsOf(map);
  const auto side = [](const TileBox& box) {
    return std::max(box.tx1 - box.tx0, box.ty1 - box.ty0);
  };
  if (parts.size() < 2 || side(BoxOf(parts)) < kFar * side(parts[0].box)) return;
  PrintLine(stderr, "the map has {} parts that are far apart:", parts.size());
  for (size_t k = 0; k < std::min(parts.size(), kMaxLines); ++k) {
    PrintLine(stderr, "  {} tiles in {}", parts[k].tiles,
              TextOf(RegionOf(parts[k].box, map.options.knot_interval_m)));
  }
  if (parts.size() > kMaxLines) PrintLine(stderr, "  and {} more", parts.size() - kMaxLines);
  const std::string region = TextOf(RegionOf(parts[0].box, map.options.knot_interval_m));
  if (source.IsFile()) {
    PrintLine(stderr, "one is kept by splinemap crop {} OUT --region {}", source.Text(), region);
  } else {
    PrintLine(stderr, "one is drawn by splinemap export {} BASE --format png --region {}",
              source.Text(), region);
  }
}

absl::Status WritePicture(const RenderFlags& flags, const MapViewSource& source) {
  const MapView& map = *source.map;
  constexpr int kSide = 1200;
  const double pixels_per_knot = flags.pixels_per_knot > 0
                                     ? flags.pixels_per_knot
                                     : std::max(1.0, FittingPixelsPerKnot(map, kSide));
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid, FittingGrid(map, pixels_per_knot));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(flags.output.path));
  Raster raster = RenderMap(map, grid);
  if (flags.marks_contradictions) MarkContradictions(source, raster);
  SPLINEMAP_RETURN_IF_ERROR(WritePng(raster, file));
  SPLINEMAP_RETURN_IF_ERROR(file.Commit());
  PrintLine(stderr, "{}: {} x {} pixels of {:.4g} m, left {:.4g} m, top {:.4g} m",
            flags.output.path, grid.width, grid.height, grid.pixel_m, grid.left_m, grid.top_m);
  return absl::OkStatus();
}

absl::StatusOr<int> Render(RenderFlags flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto arguments, ArgumentsAfterMap(flags.source));
  const bool is_preview = arguments.empty();
  if (is_preview && flags.marks_contradictions) {
    return InvalidArgument("--contradictions requires OUT, the .png to write");
  }
  if (!is_preview) {
    SPLINEMAP_ASSIGN_OR_RETURN(flags.output.path, OutputAfterMap(flags.source));
    if (!flags.output.path.ends_with(".png")) {
      return InvalidArgument("{} does not end in .png", flags.output.path);
    }
    SPLINEMAP_RETURN_IF_ERROR(CheckOutput(flags.output, MapFilesOf(flags.source)));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const MapViewSource source, OpenMapView(flags.source));
  ReportParts(flags.source, *source.map);
  if (is_preview) {
    constexpr int kOtherRows = 4;
    SPLINEMAP_ASSIGN_OR_RETURN(const std::string preview, Preview(*source.map, kOtherRows));
    std::fputs(preview.c_str(), stdout);
  } else {
    SPLINEMAP_RETURN_IF_ERROR(WritePicture(flags, source));
  }
  return source.exit_status;
}

constexpr const char* kRenderExamples = R"(
Examples:
  splinemap render lab.splinemap lab.png --px-per-knot 4
  splinemap render lab.splinemap
  splinemap render --live now.png
  splinemap render --fleet nats://hub now.png
  splinemap render fleet.splinemap fleet.png --contradictions

Evaluates the surface at every pixel: black is occupied, white free, blue-grey unknown. Without OUT
it draws a small picture in the terminal.)";

}  // namespace

void AddRender(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RenderFlags>();
  CLI::App* command = app.add_subcommand("render", "Draw a map as a PNG or in the terminal");
  command->footer(kRenderExamples);
  AddMapViewSource(*command, "MAP [OUT]", "the .png to write", flags->source);
  command
      ->add_option("--px-per-knot", flags->pixels_per_knot,
                   "Pixels per knot interval (default: to fit 1,200 pixels, at least 1)")
      ->check(CLI::Range(0.01, 64.0));
  command->add_flag("--contradictions", flags->marks_contradictions,
                    "Mark in red where a layer has obstacles and the others saw free space");
  AddForceFlag(*command, flags->output.force);
  command->callback([flags, &chosen] { chosen = [flags] { return Render(*flags); }; });
}

}  // namespace splinemap
