// The figures of the paper, and what they and recorded drives say about the defaults. Writes one
// CSV file per table; plot.py draws them.
#include <CLI/CLI.hpp>
#include <filesystem>

#include "tests/bench/accuracy/defaults.h"
#include "tests/bench/accuracy/door.h"
#include "tests/bench/accuracy/drives.h"
#include "tests/bench/accuracy/gp_room.h"
#include "tests/bench/accuracy/grid_map.h"
#include "tests/bench/accuracy/mrpt_map.h"
#include "tests/bench/accuracy/rooms.h"
#include "tests/bench/accuracy/spline_map.h"

namespace splinemap {
namespace {

// The methods of the paper's figures; the last are the project's with the paper's parameters.
std::vector<Method> PaperMethods() {
  std::vector<Method> methods = {GridMethod("grid", 100, &Nearest),
                                 GridMethod("grid bilinear", 100, &Bilinear),
                                 GridMethod("grid bicubic", 100, &Bicubic), PaperSplineMethod()};
  for (const Variant& variant : Variants()) {
    if (variant.in_paper_figures) methods.push_back(SplineMethod(variant));
  }
  return methods;
}

// Some of the variants beside their peers, for the tables over drives.
std::vector<Method> DriveMethods() {
  std::vector<Method> methods = {
      GridMethod("grid", 100, &Nearest),
      GridMethod("grid bilinear", 100, &Bilinear),
      GridMethod("grid bicubic", 100, &Bicubic),
      GridMethod("grid clamp 10", 10, &Nearest),
      GridMethod("grid bilinear clamp 10", 10, &Bilinear),
      GridMethod("grid bicubic clamp 10", 10, &Bicubic),
      GridMethod("grid bicubic clamp 10 free -0.15", 10, &Bicubic, -0.15),
      GridMethod("grid bilinear clamp 10 free -0.15", 10, &Bilinear, -0.15),
      MrptMethod("MRPT default", kMrptDefaultCertainty),
      MrptMethod("MRPT paper's kappa", kMrptPaperCertainty),
  };
  for (const Variant& variant : Variants()) {
    if (variant.compare_with_peers) methods.push_back(SplineMethod(variant));
  }
  return methods;
}

std::vector<Method> AllVariants() {
  std::vector<Method> methods;
  for (const Variant& variant : Variants()) methods.push_back(SplineMethod(variant));
  return methods;
}

struct Part {
  std::string name;
  std::function<void()> write;
};

void Run(const Effort& effort, const std::string& only, const std::string& out) {
  const auto with_grids = [](std::vector<Method> methods) {
    methods.push_back(GridMethod("grid", 100, &Nearest));
    methods.push_back(GridMethod("grid clamp 10", 10, &Nearest));
    return methods;
  };
  const std::vector<Part> parts = {
      {"fig3", [&] { WriteFig3(PaperMethods(), effort, out); }},
      {"fig5", [&] { WriteFig5(PaperMethods(), effort, out); }},
      {"maps", [&] { WriteMaps(PaperMethods(), effort, out); }},
      {"gp", [&] { WriteGp(PaperMethods(), effort, out); }},
      {"door", [&] { WriteDoor(with_grids(AllVariants()), effort, out); }},
      {"defaults",
       [&] { WriteDefaults(with_grids(AllVariants()), ReadDrives(effort), effort, out); }},
      {"hits", [&] { WriteHits(DriveMethods(), ReadDrives(effort), out); }},
      {"logs", [&] { WriteLogs(DriveMethods(), ReadDrives(effort), out); }},
  };
  for (const Part& part : parts) {
    if (only.empty() || only == part.name) part.write();
  }
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  CLI::App app("Accuracy of spline maps against other maps, as CSV tables");
  std::string out = "accuracy";
  std::string only;
  bool quick = false;
  app.add_option("--out", out, "Directory for the tables")->capture_default_str();
  app.add_option("--only", only, "One of fig3, fig5, maps, gp, door, defaults, hits, logs");
  app.add_flag("--quick", quick, "A smoke run of a few seconds; its figures mean nothing");
  CLI11_PARSE(app, argc, argv);
  std::filesystem::create_directories(out);
  splinemap::Run(quick ? splinemap::Effort::Quick() : splinemap::Effort{}, only, out);
}
