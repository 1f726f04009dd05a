#include <CLI/App.hpp>
#include <cstdio>
#include <memory>
#include <string>

#include "clients/splinemap/bus_flags.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "lib/base/status.h"
#include "splinemap/client.h"

namespace splinemap {
namespace {

struct DaemonFlags {
  BusFlags bus;
  std::string robot;
};

absl::StatusOr<std::unique_ptr<MapClient>> Connect(const DaemonFlags& flags) {
  ClientOptions options;
  options.channel_prefix = flags.bus.channel_prefix;
  options.robot = flags.robot;
  SPLINEMAP_ASSIGN_OR_RETURN(options.keys, flags.bus.Keys());
  options.deadline = flags.bus.Timeout();
  return MapClient::Connect(flags.bus.lcm_url, options);
}

absl::StatusOr<int> Save(const DaemonFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, Connect(flags));
  SPLINEMAP_RETURN_IF_ERROR(client->Save());
  PrintLine(stderr, "the daemon of {} saved its map", client->daemon().name);
  return kSuccess;
}

absl::StatusOr<int> Clear(const DaemonFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto client, Connect(flags));
  SPLINEMAP_RETURN_IF_ERROR(client->Clear());
  PrintLine(stderr, "the daemon of {} cleared its layer", client->daemon().name);
  return kSuccess;
}

constexpr const char* kSaveExamples = R"(
Examples:
  splinemap save
  splinemap save --robot robot-3

Makes a daemon save its map now. It does so by itself every save_interval_s and when it ends.)";

constexpr const char* kClearExamples = R"(
Example:
  splinemap clear --robot robot-3

Makes a daemon start its own layer anew, empty, on its disk too. Layers of other robots stay. To
keep a copy: splinemap snapshot before.)";

CLI::App* AddDaemonCommand(CLI::App& app, const std::string& name, const std::string& what,
                           const std::string& examples, DaemonFlags& flags) {
  CLI::App* command = app.add_subcommand(name, what);
  command->footer(examples);
  AddBusFlags(*command, flags.bus);
  AddTimeoutFlag(*command, flags.bus);
  return command;
}

}  // namespace

void AddSave(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<DaemonFlags>();
  CLI::App* command =
      AddDaemonCommand(app, "save", "Make a daemon save its map", kSaveExamples, *flags);
  command->add_option("--robot", flags->robot, "Robot of the daemon (default: the first to answer)")
      ->type_name("NAME");
  command->callback([flags, &chosen] { chosen = [flags] { return Save(*flags); }; });
}

void AddClear(CLI::App& app, Command& chosen) {
  auto flags = std::make_shared<DaemonFlags>();
  CLI::App* command =
      AddDaemonCommand(app, "clear", "Make a daemon empty its own layer", kClearExamples, *flags);
  command->add_option("--robot", flags->robot, "Robot of the daemon")
      ->type_name("NAME")
      ->required();
  command->callback([flags, &chosen] { chosen = [flags] { return Clear(*flags); }; });
}

}  // namespace splinemap
