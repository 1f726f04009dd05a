#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/say.h"
#include "lib/base/file.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr const char* kMainExamples = R"(
Examples:
  splinemap simulate office.lcmlog
  splinemap build office.lcmlog --out office.splinemap
  splinemap render office.splinemap office.png --px-per-knot 2
  splinemap query office.splinemap 3.0 6.5
  splinemap merge robot-1.splinemap robot-2.splinemap -o both.splinemap

splinemap COMMAND --help explains a command. Exit status: 0 done, 1 failed, 2 usage.)";

int Main(int argc, char** argv) {
  CLI::App app("splinemap: builds, asks and shows continuous occupancy maps of LCM robots.");
  app.footer(kMainExamples);
  app.set_version_flag("--version", SPLINEMAP_VERSION);
  app.require_subcommand(1);
  Command chosen;
  AddBackup(app, chosen);
  AddBuild(app, chosen);
  AddInfo(app, chosen);
  AddRender(app, chosen);
  AddQuery(app, chosen);
  AddRay(app, chosen);
  AddCheck(app, chosen);
  AddDistance(app, chosen);
  AddRaster(app, chosen);
  AddExport(app, chosen);
  AddDiff(app, chosen);
  AddLayers(app, chosen);
  AddControl(app, chosen);
  AddMerge(app, chosen);
  AddRemove(app, chosen);
  AddFlatten(app, chosen);
  AddDoctor(app, chosen);
  AddWatch(app, chosen);
  AddSnapshot(app, chosen);
  AddBridge(app, chosen);
  AddSimulate(app, chosen);
  AddImportCarmen(app, chosen);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kSuccess : kUsage;
  }
  RemoveTemporaryFilesAtSignals();
  try {
    const absl::StatusOr<int> status = chosen();
    if (status.ok()) return *status;
    fmt::print(stderr, "splinemap: {}\n", PlainLines(ErrorText(status.status())));
    return absl::IsInvalidArgument(status.status()) ? kUsage : kFailed;
  } catch (const std::exception& exception) {  // out of memory, say
    Say(stderr, "splinemap: {}", exception.what());
    return kFailed;
  }
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
