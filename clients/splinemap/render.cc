#include <algorithm>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/preview.h"
#include "clients/splinemap/say.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/map/summed_layers.h"
#include "lib/render/raster.h"
#include "lib/store/map_file.h"

namespace splinemap {
namespace {

struct RenderFlags {
  std::string map;
  std::string out;
  double pixels_per_knot = 0;  // 0: to fit
};

absl::StatusOr<int> Render(const RenderFlags& flags) {
  if (!flags.out.empty() && !flags.out.ends_with(".png")) {
    return InvalidArgument("{}: render writes a PNG; give it a name that ends in .png", flags.out);
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.map));
  const std::shared_ptr<const MapView> map = ViewOf(loaded.set);
  if (flags.out.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(const std::string preview, Preview(*map, 4));
    std::fputs(preview.c_str(), stdout);
    return ReportCorruption(loaded);
  }
  constexpr int kSide = 1200;
  const double pixels_per_knot = flags.pixels_per_knot > 0
                                     ? flags.pixels_per_knot
                                     : std::max(1.0, FittingPixelsPerKnot(*map, kSide));
  SPLINEMAP_ASSIGN_OR_RETURN(const PixelGrid grid, FittingGrid(*map, pixels_per_knot));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(flags.out));
  SPLINEMAP_RETURN_IF_ERROR(WritePng(RenderMap(*map, grid), file));
  SPLINEMAP_RETURN_IF_ERROR(file.Commit());
  Say(stderr, "{}: {} x {} pixels of {:.4g} m, left {:.4g} m, top {:.4g} m", flags.out, grid.width,
      grid.height, grid.pixel_m, grid.left_m, grid.top_m);
  return ReportCorruption(loaded);
}

constexpr const char* kRenderExamples = R"(
Examples:
  splinemap render lab.splinemap lab.png --px-per-knot 4
  splinemap render lab.splinemap

Evaluates the surface at every pixel: black occupied, white free, blue-grey never seen. Without
OUT.png it draws a small picture in the terminal.)";

}  // namespace

void AddRender(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RenderFlags>();
  CLI::App* command = app.add_subcommand("render", "Draw a map as PNG or in the terminal");
  command->footer(kRenderExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("OUT.png", flags->out, "Picture to write");
  command
      ->add_option("--px-per-knot", flags->pixels_per_knot,
                   "Pixels per knot interval each way (default: for a picture of about 1,200 "
                   "pixels, at least 1)")
      ->check(CLI::Range(0.01, 64.0));
  command->callback([flags, &chosen] { chosen = [flags] { return Render(*flags); }; });
}

}  // namespace splinemap
