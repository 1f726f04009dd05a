// The figures of the paper, and what they and recorded drives say about the defaults. Writes one
// CSV file per table; plot.py draws them.
#include <CLI/CLI.hpp>
#include <filesystem>

#include "tests/bench/accuracy/grid_map.h"
#include "tests/bench/accuracy/rooms.h"
#include "tests/bench/accuracy/spline_map.h"

namespace splinemap {
namespace {

// The methods of the paper's figures.
std::vector<Method> PaperMethods() {
  return {GridMethod("grid", 100, &Nearest), GridMethod("grid bilinear", 100, &Bilinear),
          GridMethod("grid bicubic", 100, &Bicubic), PaperSplineMethod(),
          SplineMethod(Variants().front())};
}

void Run(const Effort& effort, const std::string& out) {
  WriteFig3(PaperMethods(), effort, out);
  WriteFig5(PaperMethods(), effort, out);
  WriteMaps(PaperMethods(), effort, out);
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) {
  CLI::App app("Accuracy of spline maps against other maps, as CSV tables");
  std::string out = "accuracy";
  bool quick = false;
  app.add_option("--out", out, "Directory for the tables")->capture_default_str();
  app.add_flag("--quick", quick, "A smoke run of a few seconds; its figures mean nothing");
  CLI11_PARSE(app, argc, argv);
  std::filesystem::create_directories(out);
  splinemap::Run(quick ? splinemap::Effort::Quick() : splinemap::Effort{}, out);
}
