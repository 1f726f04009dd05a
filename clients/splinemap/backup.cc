#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

struct BackupFlags {
  std::string map;
  MapOutput output;
};

absl::StatusOr<int> Backup(const BackupFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutputOf({flags.map}, flags.output));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadInput(flags.map, flags.output));
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.out));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap written, ReadMapFile(flags.output.out));
  fmt::print(stderr, "{} layers, {} tiles in {}\n", written.set.layers.size(),
             ViewOf(written.set)->tiles.size(), flags.output.out);
  const int status = ReportCorruption(written);
  return loaded.corruption.empty() ? status : kFailed;
}

constexpr const char* kBackupExamples = R"(
Example:
  splinemap backup robot.splinemap robot-monday.splinemap

The last save of the map, whole, while a splinemapd goes on writing to it; read again after it was
written. A copy that cp makes of such a file may be torn.)";

}  // namespace

void AddBackup(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<BackupFlags>();
  CLI::App* command = app.add_subcommand("backup", "Copy a map, also while a daemon writes to it");
  command->footer(kBackupExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("OUT", flags->output.out, "Map file to write")->required();
  command->add_flag("--force", flags->output.force, "Replace the map file if it exists");
  command->add_flag("--damaged", flags->output.accepts_damaged,
                    "Take what is left of a damaged file; exit status 1 all the same");
  command->callback([flags, &chosen] { chosen = [flags] { return Backup(*flags); }; });
}

}  // namespace splinemap
