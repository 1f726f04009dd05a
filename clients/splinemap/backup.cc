#include <CLI/App.hpp>
#include <cstdio>
#include <memory>

#include "absl/cleanup/cleanup.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "splinemap/file.h"

namespace splinemap {
namespace {

struct BackupFlags {
  std::string map;
  Output output;
};

absl::Status IsDamaged(const std::string& map) {
  return DataLoss("{} is damaged; nothing is written. splinemap repair writes what can be read",
                  map);
}

absl::StatusOr<int> Backup(const BackupFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  const std::string part = TemporaryPathFor(flags.output.path);
  const absl::Cleanup remove_part = [&] { MapFile::Remove(part); };
  const absl::Status copied = MapFile::Copy(flags.map, part);
  if (absl::IsDataLoss(copied)) return IsDamaged(flags.map);
  SPLINEMAP_RETURN_IF_ERROR(copied);
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap copy, ReadMapFile(part));
  if (!copy.corruption.empty()) return IsDamaged(flags.map);
  SPLINEMAP_RETURN_IF_ERROR(MapFile::Rename(part, flags.output.path));
  PrintLine(stderr, "{} layers in {}", copy.set.layers.size(), flags.output.path);
  return kSuccess;
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
  command->callback([flags, &chosen] { chosen = [flags] { return Backup(*flags); }; });
}

}  // namespace splinemap
