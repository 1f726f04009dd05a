#pragma once

#include <CLI/App.hpp>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/store/map_file.h"

namespace splinemap {

// Exit statuses of the tool.
inline constexpr int kSuccess = 0;
inline constexpr int kFailed = 1;
inline constexpr int kUsage = 2;

// What a chosen subcommand does: data on stdout, messages on stderr. Returns the exit status; an
// error is shown and means kFailed, or kUsage for InvalidArgument.
using Command = std::function<absl::StatusOr<int>()>;

// Whether a command may write this file: its folder is there, and so is the file only with `force`.
absl::Status CheckOutput(const std::string& path, bool force);

// Writes the map to `out`, whole or not at all; not at all where something of it cannot be true.
absl::Status SaveAs(const LayerSet& set, const std::string& out);

// What commands that make a map file of others take beside their inputs.
struct MapOutput {
  std::string out;
  bool force = false;
  bool accepts_damaged = false;
};
void AddMapOutputFlags(CLI::App& command, MapOutput& output);

// Whether such a command may write its output: that is none of the inputs, and not in use.
absl::Status CheckOutputOf(const std::vector<std::string>& inputs, const MapOutput& output);
// Shows what was damaged of an input, on stderr. DataLoss where that is something, unless it is
// accepted.
absl::Status CheckInput(const LoadedMap& loaded, const std::string& path, const MapOutput& output);
// Reads and checks an input.
absl::StatusOr<LoadedMap> ReadInput(const std::string& path, const MapOutput& output);

// Shows what was damaged, on stderr. The exit status of a command that else succeeded.
int ReportCorruption(const LoadedMap& loaded);

// Each adds one subcommand, which sets `chosen` when it is on the command line.
void AddBackup(CLI::App& app, Command& chosen);
void AddBridge(CLI::App& app, Command& chosen);
void AddBuild(CLI::App& app, Command& chosen);
void AddCheck(CLI::App& app, Command& chosen);
void AddControl(CLI::App& app, Command& chosen);
void AddDiff(CLI::App& app, Command& chosen);
void AddDistance(CLI::App& app, Command& chosen);
void AddDoctor(CLI::App& app, Command& chosen);
void AddExport(CLI::App& app, Command& chosen);
void AddFlatten(CLI::App& app, Command& chosen);
void AddImportCarmen(CLI::App& app, Command& chosen);
void AddInfo(CLI::App& app, Command& chosen);
void AddLayers(CLI::App& app, Command& chosen);
void AddMerge(CLI::App& app, Command& chosen);
void AddQuery(CLI::App& app, Command& chosen);
void AddRaster(CLI::App& app, Command& chosen);
void AddRay(CLI::App& app, Command& chosen);
void AddRemove(CLI::App& app, Command& chosen);
void AddRender(CLI::App& app, Command& chosen);
void AddSimulate(CLI::App& app, Command& chosen);
void AddSnapshot(CLI::App& app, Command& chosen);
void AddWatch(CLI::App& app, Command& chosen);

}  // namespace splinemap
