#include <CLI/App.hpp>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "lib/map/summed_layers.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct BackupFlags {
  std::string map;
  Output output;
  bool accepts_corrupt = false;
};

absl::StatusOr<int> Backup(const BackupFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadInput(flags.map, flags.accepts_corrupt));
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.path));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap written, ReadMapFile(flags.output.path));
  PrintLine(stderr, "{} layers, {} tiles in {}", written.set.layers.size(),
            ViewOf(written.set)->tiles.size(), flags.output.path);
  const int status = ReportCorruption(written);
  return loaded.corruption.empty() ? status : kFailed;
}

constexpr const char* kBackupExamples = R"(
Example:
  splinemap backup robot.splinemap robot-monday.splinemap

Copies the last save of a map, also while splinemapd saves to it, and reads the copy once to check
it. A copy by cp of a file in use may be torn.)";

}  // namespace

void AddBackup(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<BackupFlags>();
  CLI::App* command = app.add_subcommand("backup", "Copy a map file, also one in use");
  command->footer(kBackupExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return Backup(*flags); }; });
}

}  // namespace splinemap
