#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <string>

#include "clients/splinemap/commands.h"
#include "clients/splinemap/files.h"
#include "clients/splinemap/print.h"
#include "clients/splinemap/refold.h"
#include "clients/splinemap/time_flag.h"
#include "lib/base/status.h"
#include "splinemap/file.h"
#include "splinemap/scan_archive.h"

namespace splinemap {
namespace {

struct ForgetFlags {
  std::string map, before;
  Output output;
  bool accepts_corrupt = false;
};

absl::StatusOr<int> Forget(const ForgetFlags& flags) {
  if (flags.output.path.empty()) return InvalidArgument("give the map file to write with --out");
  SPLINEMAP_RETURN_IF_ERROR(CheckMapOutput(flags.output, {flags.map}));
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadInput(flags.map, flags.accepts_corrupt));
  SPLINEMAP_ASSIGN_OR_RETURN(const Utime before, ParseTime(flags.before, loaded.set));
  int64_t scans_before = 0;
  for (const LayerSnapshot& layer : loaded.set.layers) scans_before += layer.archive->num_scans();
  SPLINEMAP_RETURN_IF_ERROR(Refold(
      loaded.set, {}, [&](const ScanArchive& archive) { return ForgetBefore(archive, before); }));
  int64_t scans = 0;
  for (const LayerSnapshot& layer : loaded.set.layers) scans += layer.archive->num_scans();
  if (scans == 0) {
    return FailedPrecondition("all scans of {} are before {}; nothing would be left", flags.map,
                              TextOf(before));
  }
  SPLINEMAP_RETURN_IF_ERROR(SaveAs(loaded.set, flags.output.path));
  PrintLine(stderr, "forgot {} scans before {}; {} scans in {}", scans_before - scans,
            TextOf(before), scans, flags.output.path);
  return loaded.corruption.empty() ? kSuccess : kFailed;
}

}  // namespace

void AddForget(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<ForgetFlags>();
  CLI::App* command = app.add_subcommand("forget", "Make the map of the scans since a time");
  command->footer(
      std::string("\nExample:\n  splinemap forget lab.splinemap --before end-1h --out "
                  "now.splinemap\n\nThe map is as if the older scans had never been made.") +
      kTimeFooter);
  command->add_option("MAP", flags->map, "Map file")->required();
  command->add_option("--before", flags->before, "Scans before this time are forgotten")
      ->type_name("TIME")
      ->required();
  AddOutOption(*command, "Map file to write", flags->output);
  AddCorruptFlag(*command, flags->accepts_corrupt);
  command->callback([flags, &chosen] { chosen = [flags] { return Forget(*flags); }; });
}

}  // namespace splinemap
