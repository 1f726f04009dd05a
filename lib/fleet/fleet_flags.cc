#include "lib/fleet/fleet_flags.h"

#include <CLI/App.hpp>
#include <algorithm>
#include <array>

#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr const char* kFleet = "--fleet";
constexpr const char* kFleetMap = "--fleet-map";
constexpr const char* kCredentials = "--credentials";

}  // namespace

CLI::Option* AddFleetFlags(CLI::App& command, FleetAddress& fleet) {
  const CLI::App* program = &command;
  while (program->get_parent() != nullptr) program = program->get_parent();
  fleet.program = program->get_name();
  CLI::Option* const servers =
      command.add_option(kFleet, fleet.servers, "Use the map of a fleet, on these NATS servers")
          ->type_name("URL[,URL]..")
          ->check([](const std::string& text) {
            FleetAddress address;
            address.servers = text;
            return ErrorText(CheckFleetAddress(address));
          });
  command.add_option(kFleetMap, fleet.map, "Name of the map (default map)")
      ->type_name("NAME")
      ->needs(servers)
      ->group("With --fleet");
  command
      .add_option(kCredentials, fleet.credentials,
                  "Folder that deploy/fleet/credentials.sh makes (default: none)")
      ->type_name("FOLDER")
      ->needs(servers)
      ->group("With --fleet");
  return servers;
}

bool IsFleetFlag(const std::string& word) {
  const std::string flag = word.substr(0, word.find('='));
  return flag == kFleet || flag == kFleetMap || flag == kCredentials;
}

}  // namespace splinemap
