#pragma once

#include <functional>

#include "absl/status/statusor.h"

namespace CLI {
class App;
}

namespace splinemap {

// Exit statuses of the tool.
inline constexpr int kSuccess = 0;
inline constexpr int kFailed = 1;
inline constexpr int kUsage = 2;

// What a chosen subcommand does: data on stdout, messages on stderr. Returns the exit status; an
// error is printed and means kFailed, or kUsage for InvalidArgument.
using Command = std::function<absl::StatusOr<int>()>;

// Each adds one subcommand, which sets `chosen` when it is on the command line.
void AddAlign(CLI::App& app, Command& chosen);
void AddBackup(CLI::App& app, Command& chosen);
void AddBridge(CLI::App& app, Command& chosen);
void AddBuild(CLI::App& app, Command& chosen);
void AddChanges(CLI::App& app, Command& chosen);
void AddCheck(CLI::App& app, Command& chosen);
void AddClear(CLI::App& app, Command& chosen);
void AddCorrect(CLI::App& app, Command& chosen);
void AddCrop(CLI::App& app, Command& chosen);
void AddDiff(CLI::App& app, Command& chosen);
void AddDistance(CLI::App& app, Command& chosen);
void AddDoctor(CLI::App& app, Command& chosen);
void AddExport(CLI::App& app, Command& chosen);
void AddFlatten(CLI::App& app, Command& chosen);
void AddFold(CLI::App& app, Command& chosen);
void AddForget(CLI::App& app, Command& chosen);
void AddImportCarmen(CLI::App& app, Command& chosen);
void AddImportRos(CLI::App& app, Command& chosen);
void AddInfo(CLI::App& app, Command& chosen);
void AddKeys(CLI::App& app, Command& chosen);
void AddLayer(CLI::App& app, Command& chosen);
void AddLayers(CLI::App& app, Command& chosen);
void AddMerge(CLI::App& app, Command& chosen);
void AddPrefixChannels(CLI::App& app, Command& chosen);
void AddQuery(CLI::App& app, Command& chosen);
void AddRaster(CLI::App& app, Command& chosen);
void AddRay(CLI::App& app, Command& chosen);
void AddRender(CLI::App& app, Command& chosen);
void AddRepair(CLI::App& app, Command& chosen);
void AddSave(CLI::App& app, Command& chosen);
void AddSimulate(CLI::App& app, Command& chosen);
void AddSnapshot(CLI::App& app, Command& chosen);
void AddTrajectory(CLI::App& app, Command& chosen);
void AddVerify(CLI::App& app, Command& chosen);
void AddWatch(CLI::App& app, Command& chosen);

}  // namespace splinemap
