#include <CLI/App.hpp>
#include <cstdio>
#include <memory>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/layer_name.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

struct RepairFlags {
  std::string map;
  Output output;
};

int64_t ScansOf(const LayerSnapshot& layer) {
  return layer.archive == nullptr ? 0 : layer.archive->num_scans();
}

// "37 of 40 tiles"
std::string KeptText(int64_t kept, int64_t saved, const char* what) {
  return kept == saved ? fmt::format("all {} {}", kept, what)
                       : fmt::format("{} of {} {}", kept, saved, what);
}

absl::StatusOr<int> Repair(const RepairFlags& flags) {
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.map));
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.path));
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap written, ReadMapFile(flags.output.path));
  if (!written.corruption.empty()) {
    return DataLoss("{} is damaged as well: {}", flags.output.path, written.corruption.front());
  }
  const int status = ReportCorruption(loaded);
  for (const LayerSnapshot& layer : loaded.set.layers) {
    const SavedCounts& saved = loaded.saved.at(layer.id);
    const auto tiles = static_cast<int64_t>(layer.tiles.size());
    const bool can_fold = tiles != saved.tiles && ScansOf(layer) == saved.scans && saved.scans > 0;
    PrintLine(stdout, "{}: {}, {}{}", NameOf(layer.id), KeptText(tiles, saved.tiles, "tiles"),
              KeptText(ScansOf(layer), saved.scans, "scans"),
              can_fold ? "; splinemap fold makes the tiles anew of the scans" : "");
  }
  PrintLine(stderr, "{} of {} is in {}", status == kSuccess ? "all" : "what can be read", flags.map,
            flags.output.path);
  return status;
}

constexpr const char* kRepairExamples = R"(
Example:
  splinemap repair robot.splinemap repaired.splinemap

Writes every tile, scan and setting that can be read of a damaged map into a new file, and says what
was lost. The damaged file stays as it is. splinemapd does the same to its own map when it starts.
Exit status: 0 the map is not damaged, 1 it is, or nothing can be read and OUT is not written.)";

}  // namespace

void AddRepair(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<RepairFlags>();
  CLI::App* command = app.add_subcommand("repair", "Write what can be read of a damaged map file");
  command->footer(kRepairExamples);
  command->add_option("MAP", flags->map, "Map file")->required();
  AddOutput(*command, "OUT", "Map file to write", flags->output);
  command->callback([flags, &chosen] { chosen = [flags] { return Repair(*flags); }; });
}

}  // namespace splinemap
